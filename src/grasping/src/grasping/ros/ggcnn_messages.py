"""Grasps as messages."""

from __future__ import annotations

import math

import numpy as np
import rospy
from geometry_msgs.msg import Point, PoseStamped
from std_msgs.msg import ColorRGBA, Float32MultiArray, Header
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE
from common.numbers import LABEL_M
from common.ros.conversions import message_from_pose, stamped_pose
from grasp_msgs.msg import Grasp, GraspList
from grasping.pipeline.pipeline import GraspProposal
from grasping.pipeline.tool_pose import Reachability

FINGER_M = 0.05
GREY = ColorRGBA(0.5, 0.5, 0.5, 0.8)


def grasp_list(header: Header, proposals: list[tuple[GraspProposal, Reachability]], reason: str) -> GraspList:
    """Returns the message of all grasps; `reason` says why there is none."""
    return GraspList(header, [_grasp(header, proposal, reach) for proposal, reach in proposals], reason)


def _grasp(header: Header, proposal: GraspProposal, reach: Reachability) -> Grasp:
    deviations = 6
    known = proposal.T_base_grasp is not None
    uncertainty = proposal.uncertainty
    return Grasp(
        id=proposal.id,
        pose_camera=message_from_pose(proposal.T_camera_grasp),
        pose_base=stamped_pose(proposal.T_base_grasp, BASE, header.stamp) if known else PoseStamped(),
        width=proposal.width,
        quality=proposal.quality,
        angle=proposal.angle,
        pixel=proposal.pixel,
        probability=math.nan if uncertainty is None else uncertainty.probability,
        deviations=[math.nan] * deviations if uncertainty is None else uncertainty.pose_sd.tolist(),
        width_deviation=math.nan if uncertainty is None else uncertainty.opening_sd,
        own_approach=proposal.own_approach,
        reachable=reach.reachable,
        reason=reach.reason,
    )


def command(proposal: GraspProposal, between: float) -> Float32MultiArray:
    """Returns the published node's six numbers: x, y, z before the camera [m], angle [rad], opening [px of the
    camera's image], and how far away the nearest thing between the fingers is [mm]; `between` is that in m.
    """
    x, y, z = proposal.T_camera_grasp[:3, 3]
    return Float32MultiArray(data=[x, y, z, proposal.angle, proposal.width_px, 1e3 * between])


def markers(header: Header, proposals: list[tuple[GraspProposal, Reachability]]) -> MarkerArray:
    """Returns one gripper a grasp, red for the quality 0 to green for 1, grey where the arm does not get there;
    with number and quality where no better one stands near."""
    line_m = 0.003
    best_line_m = 0.006
    apart_m = 2.0 * LABEL_M  # a label nearer to that of a better grasp would cover it
    marker_life_s = 1.0  # markers of a node that is gone go too
    array = MarkerArray([Marker(header=header, ns="grasps", action=Marker.DELETEALL)])
    labelled: list[np.ndarray] = []
    for i, (proposal, reach) in enumerate(proposals):
        colour = GREY if reach.refused else _colour(proposal.quality)
        shape = Marker(header=header, ns="grasps", id=proposal.id, type=Marker.LINE_LIST, color=colour)
        shape.pose = message_from_pose(proposal.T_camera_grasp)
        shape.scale.x = line_m if i else best_line_m
        shape.points = _gripper(proposal.width)
        at = (proposal.T_camera_grasp @ (0.0, 0.0, -1.8 * FINGER_M, 1.0))[:3]
        text = Marker(header=header, ns="labels", id=proposal.id, type=Marker.TEXT_VIEW_FACING, color=colour)
        text.pose.position = Point(*at)
        text.pose.orientation.w = 1.0
        text.scale.z = LABEL_M
        text.text = f"{proposal.id}: {proposal.quality:.2f}"
        free = all(np.linalg.norm(at - other) > apart_m for other in labelled)
        if free:
            labelled.append(at)
        for marker in (shape, text) if free else (shape,):
            marker.lifetime = rospy.Duration(marker_life_s)
            array.markers.append(marker)
    return array


def _gripper(width: float) -> list[Point]:
    """Returns pairs of points: stem, bar, and two fingers that end at the grasp, in its frame."""
    half, up = 0.5 * max(0.0, width), -FINGER_M
    corners = np.array([[0, 2 * up], [0, up], [-half, up], [half, up], [-half, up], [-half, 0], [half, up], [half, 0]])
    return [Point(x, 0.0, z) for x, z in corners]


def _colour(quality: float) -> ColorRGBA:
    fraction = min(1.0, max(0.0, quality)) if math.isfinite(quality) else 0.0
    return ColorRGBA(min(1.0, 2.0 - 2.0 * fraction), min(1.0, 2.0 * fraction), 0.1, 1.0)

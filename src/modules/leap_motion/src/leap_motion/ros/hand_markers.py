"""The tracker's hands as markers for RViz."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from leap_motion.frames import TrackedHand
from leap_motion.skeleton import skeleton

NORMAL = 101  # numbers of the markers; those of bones and joints are their kinds
LABEL = 102


def hand_markers(
    hands: Iterable[TrackedHand], frame: str, lifetime: rospy.Duration, details: bool = False
) -> list[Marker]:
    """Returns bones and joints of the hands, red where the tracker is not confident, green where it is; with
    `details` also palm, its axes and a label, and of a hand without joints these alone."""
    bone_width_m = 0.006
    joint_width_m = 0.012
    text_height_m = 0.015
    shaft_m = 0.004  # diameters of an arrow
    head_m = 0.01
    direction = 100  # numbers of the markers; those of bones and joints are their kinds
    markers = []
    for hand in hands:
        drawn = skeleton(hand)
        if drawn is None or not (details or drawn.bones.size):
            continue
        side = "left" if hand.is_left else "right"
        shapes = [(Marker.LINE_LIST, drawn.bones, bone_width_m), (Marker.SPHERE_LIST, drawn.joints, joint_width_m)]
        for kind, points, width in shapes:
            if points.size:
                drawing = marker(side, kind, kind, frame, lifetime)
                drawing.scale.x = drawing.scale.y = drawing.scale.z = width
                drawing.color, drawing.points = ColorRGBA(*drawn.colour, 1.0), _points(points)
                markers.append(drawing)
        if not details:
            continue
        for number, points in ((direction, drawn.direction), (NORMAL, drawn.normal)):
            arrow = marker(side, Marker.ARROW, number, frame, lifetime)
            arrow.scale.x, arrow.scale.y, arrow.points = shaft_m, head_m, _points(points)
            arrow.color = ColorRGBA(0.35, 0.6, 1.0, 1.0)
            markers.append(arrow)
        label = marker(side, Marker.TEXT_VIEW_FACING, LABEL, frame, lifetime)
        label.pose.position, label.scale.z = Point(*drawn.label_at.tolist()), text_height_m
        label.text, label.color = drawn.label, ColorRGBA(1.0, 1.0, 1.0, 1.0)
        markers.append(label)
    return markers


def marker(namespace: str, kind: int, number: int, frame: str, lifetime: rospy.Duration) -> Marker:
    """Returns a marker without a stamp, which follows the newest frame."""
    made = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, frame_locked=True, lifetime=lifetime)
    made.header.frame_id = frame
    made.pose = Pose(Point(), Quaternion(w=1.0))
    return made


def _points(points: np.ndarray) -> list[Point]:
    return [Point(*point) for point in points.tolist()]

"""The workspace as markers for RViz, on kuka/workspace."""

from __future__ import annotations

import rospy
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE
from kuka_control.model.workspace import Workspace, boundary_lines

LINE_WIDTH_M = 0.003
CENTRE_DIAMETER_M = 0.02


def publish_workspace(workspace: Workspace, centre) -> rospy.Publisher:
    """Publishes the boundary lines and the centre once, latched; the publisher is to be kept."""
    publisher = rospy.Publisher("kuka/workspace", MarkerArray, queue_size=1, latch=True)
    lines = [
        _marker(i, Marker.LINE_STRIP, LINE_WIDTH_M, [Point(*p) for p in line])
        for i, line in enumerate(boundary_lines(workspace))
    ]
    middle = _marker(len(lines), Marker.SPHERE_LIST, CENTRE_DIAMETER_M, [Point(*centre)])
    publisher.publish(MarkerArray([*lines, middle]))
    return publisher


def _marker(number: int, kind: int, size: float, points: list) -> Marker:
    marker = Marker(ns="workspace", id=number, type=kind, action=Marker.ADD, points=points, frame_locked=True)
    marker.header.frame_id = BASE
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(size, size, size)
    marker.color = ColorRGBA(0.2, 0.7, 1.0, 0.8)
    return marker

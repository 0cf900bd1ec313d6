"""The operator's hands, the pressure on the robot's fingers and the rows of the operator's view as markers for RViz."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE, VIRTUAL_LEAP
from common.operator_rows import BRIGHT_COLOURS, Row, RowTone, plain_text
from leap_motion.frames import TrackedHand
from rig_description.hand import EXTENT, TAXEL_NORMALS, TAXEL_POSITIONS

LIFETIME = rospy.Duration.from_sec(1.0)  # a marker that is not renewed vanishes; the rows come every 0.5 s
BONE_WIDTH_M, JOINT_WIDTH_M, BAR_WIDTH_M = 0.006, 0.012, 0.004
SHORTEST_BAR_M, LONGEST_BAR_M = 0.001, 0.03
TEXT_HEIGHT_M, TEXT_COLUMNS = 0.03, 44
TEXT_AT = (0.0, 0.5, 0.6)  # in the base, beside the arm [m]
WORST = (RowTone.FAULT, RowTone.WARNING, RowTone.GOOD, RowTone.NORMAL, RowTone.STALE)


def hand_markers(hands: Iterable[TrackedHand]) -> MarkerArray:
    """Returns the joints and bones of the hands, red where the tracker is not confident, green where it is."""
    markers = []
    for hand in hands:
        if hand.joints is None or not np.isfinite(hand.joints).all():
            continue
        bones = np.stack((hand.joints[:, :-1], hand.joints[:, 1:]), axis=2).reshape(-1, 3)
        for kind, points, width in (
            (Marker.LINE_LIST, bones, BONE_WIDTH_M),
            (Marker.SPHERE_LIST, np.vstack((hand.joints.reshape(-1, 3), hand.palm)), JOINT_WIDTH_M),
        ):
            marker = _marker("left" if hand.is_left else "right", kind, kind, VIRTUAL_LEAP)
            marker.scale.x = marker.scale.y = marker.scale.z = width
            marker.color = _traffic_light(hand.confidence)
            marker.points = [Point(*point) for point in points.tolist()]
            markers.append(marker)
    return MarkerArray(markers)


def view_markers(rows: Sequence[Row], pressures: Sequence[Sequence[float]]) -> MarkerArray:
    """Returns the rows as a text beside the arm, and a bar for each taxel on the back of its finger.

    `pressures` are those of the nine taxels of index, middle and thumb as fractions of a full bar; empty if unknown.
    """
    text = _marker("text", Marker.TEXT_VIEW_FACING, 0, BASE)
    text.pose.position, text.scale.z = Point(*TEXT_AT), TEXT_HEIGHT_M
    text.text = plain_text(rows, TEXT_COLUMNS)
    tones = {row.tone for row in rows}
    colour = BRIGHT_COLOURS[next((tone for tone in WORST if tone in tones), RowTone.STALE)]
    text.color = ColorRGBA(*(int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)), 1.0)
    bars = [
        _bars(f"{part}_{finger + 1}", part, fractions)
        for finger, taxels in enumerate(pressures)
        for part, fractions in (("proximal", taxels[:5]), ("distal", taxels[5:]))
    ]
    return MarkerArray([text, *bars])


def _bars(link: str, part: str, fractions: Sequence[float]) -> Marker:
    marker = _marker(f"touch {link}", Marker.LINE_LIST, 0, f"reflex/{link}")
    marker.scale.x = BAR_WIDTH_M
    back = TAXEL_POSITIONS[part].copy()
    back[:, 2] = EXTENT[part][0][2]
    for start, normal, fraction in zip(back, TAXEL_NORMALS[part], fractions):
        end = start - normal * (SHORTEST_BAR_M + fraction * LONGEST_BAR_M)
        marker.points += [Point(*start), Point(*end)]
        marker.colors += 2 * [_traffic_light(1.0 - fraction)]
    marker.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
    return marker


def _marker(namespace: str, kind: int, number: int, frame: str) -> Marker:
    """Returns a marker without a stamp, which follows the newest frame."""
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, frame_locked=True, lifetime=LIFETIME)
    marker.header.frame_id = frame
    marker.pose = Pose(Point(), Quaternion(w=1.0))
    return marker


def _traffic_light(good: float) -> ColorRGBA:
    """Returns red for 0, yellow for a half, green for 1."""
    good = min(max(good, 0.0), 1.0) if math.isfinite(good) else 0.0
    return ColorRGBA(min(1.0, 2.0 - 2.0 * good), min(1.0, 2.0 * good) * 0.85, 0.15, 1.0)

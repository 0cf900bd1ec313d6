"""The rectangle metric of the grasp data sets: a grasp is right when it is like one labelled rectangle.

A rectangle stands for the opening (its length) and half of that (its height), as the published code has it.
"""

from __future__ import annotations

import cv2
import numpy as np

from grasping.network.maps import Peak

MAX_ANGLE_RAD = np.pi / 6.0
MIN_OVERLAP = 0.25


def is_right(peak: Peak, labels: list[Peak]) -> bool:
    """Returns whether a grasp is within 30 degrees of a label and shares 25 % of the area of both together."""
    return any(
        angle_between(peak.angle, label.angle) < MAX_ANGLE_RAD and overlap(peak, label) > MIN_OVERLAP
        for label in labels
    )


def angle_between(a: float, b: float) -> float:
    """Returns the angle between two lines, in [0, pi/2] [rad]."""
    return abs((a - b + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def overlap(a: Peak, b: Peak) -> float:
    """Returns the area of the rectangles' intersection over that of their union."""
    if min(a.width, b.width) <= 0.0:
        return 0.0
    _, corners = cv2.rotatedRectangleIntersection(_rectangle(a), _rectangle(b))
    if corners is None:
        return 0.0
    common = cv2.contourArea(cv2.convexHull(corners))
    return common / (0.5 * a.width**2 + 0.5 * b.width**2 - common)


def _rectangle(peak: Peak) -> tuple[tuple[float, float], tuple[float, float], float]:
    return (float(peak.column), float(peak.row)), (peak.width, 0.5 * peak.width), -float(np.degrees(peak.angle))

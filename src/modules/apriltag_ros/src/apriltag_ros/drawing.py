"""The picture with the outlines and ids of what was detected."""

from __future__ import annotations

import cv2
import numpy as np

from apriltag_ros.finder import FoundTag

OUTLINE_BGR, TOP_BGR = (0, 220, 0), (0, 0, 255)
SUBPIXEL_BITS = 4


def drawn(grey: np.ndarray, found: tuple[FoundTag, ...]) -> np.ndarray:
    """Returns a picture, shape (height, width, 3), blue green red, with the tags outlined; their top edges are red."""
    picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    for tag in found:
        points = np.rint(tag.corners * 2**SUBPIXEL_BITS).astype(np.int32)
        for i, (start, end) in enumerate(zip(points, np.roll(points, -1, axis=0))):
            colour = TOP_BGR if i == 0 else OUTLINE_BGR
            cv2.line(picture, tuple(map(int, start)), tuple(map(int, end)), colour, 2, cv2.LINE_AA, SUBPIXEL_BITS)
        x, y = np.rint(tag.corners.mean(axis=0)).astype(int)
        cv2.putText(picture, str(tag.id), (int(x) - 8, int(y) + 8), cv2.FONT_HERSHEY_SIMPLEX, 0.7, TOP_BGR, 2)
    return picture

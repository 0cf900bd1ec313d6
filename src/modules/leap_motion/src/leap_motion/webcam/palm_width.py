"""The palm width of a person, from a bank card or a printed tag beside the flat hand."""

from __future__ import annotations

import math

import cv2
import numpy as np

from leap_motion.service.hand import PALM_WIDTH_MM
from leap_motion.webcam.palm_pose import PALM, TEMPLATE_MM

CARD_MM = (85.6, 53.98)  # ISO/IEC 7810 ID-1
INDEX_KNUCKLE, LITTLE_KNUCKLE = PALM[1], PALM[4]
WIDTH_OF_KNUCKLES = PALM_WIDTH_MM / float(np.linalg.norm(TEMPLATE_MM[4] - TEMPLATE_MM[1]))
NARROWEST_MM, WIDEST_MM = 55.0, 120.0


def find_card(image: np.ndarray) -> np.ndarray | None:
    """Returns the corners of the largest rectangle in an image, clockwise, a long side first, shape (4, 2) [px]."""
    least_area = 0.005  # of the image, that a card must cover
    edges = cv2.Canny(cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (5, 5), 0), 40, 120)
    edges = cv2.dilate(edges, np.ones((3, 3), np.uint8))
    best, most = None, least_area * edges.size
    for contour in cv2.findContours(edges, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)[0]:
        outline = cv2.approxPolyDP(contour, 0.03 * cv2.arcLength(contour, True), True)
        area = abs(cv2.contourArea(outline))
        if len(outline) == 4 and cv2.isContourConvex(outline) and area > most:
            best, most = outline[:, 0].astype(float), area
    if best is None:
        return None
    if cv2.contourArea(best.astype(np.float32), oriented=True) < 0.0:
        best = best[::-1]
    sides = np.linalg.norm(np.roll(best, -1, axis=0) - best, axis=1)
    return best if sides[0] + sides[2] >= sides[1] + sides[3] else np.roll(best, -1, axis=0)


def find_tag(image: np.ndarray) -> np.ndarray | None:
    """Returns the corners of the only tag of the family 36h11 in an image, shape (4, 2) [px], or None."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners = cv2.aruco.ArucoDetector(family).detectMarkers(image)[0]
    return corners[0][0].astype(float) if len(corners) == 1 else None


def palm_width(corners: np.ndarray, size: tuple[float, float], rays: np.ndarray) -> float | None:
    """Returns the width of a palm [mm] that lies in the plane of a rectangle of a size (width, height) [mm].
    `corners`: rays of its corners, shape (4, 2); `rays`: of the hand's landmarks, shape (21, 2). None where no such
    rectangle looks so, or no palm is so wide."""
    most_residual = 0.03  # of a card's corners against its size; a rectangle of another shape has more
    w, h = size
    model = 0.5 * np.array([[-w, -h, 0.0], [w, -h, 0.0], [w, h, 0.0], [-w, h, 0.0]])
    good, turn, shift = cv2.solvePnP(model, corners[:, None], np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_SQPNP)
    if not good or not (np.isfinite(turn).all() and shift[2, 0] > 1.0):
        return None
    seen = cv2.projectPoints(model, turn, shift, np.eye(3), np.zeros(5))[0][:, 0]
    spread = float(np.linalg.norm(corners - corners.mean(axis=0)))
    if np.linalg.norm(seen - corners) > most_residual * spread:
        return None
    normal = cv2.Rodrigues(turn)[0][:, 2]
    knuckles = np.array([[*rays[i], 1.0] for i in (INDEX_KNUCKLE, LITTLE_KNUCKLE)])
    along = knuckles @ normal
    if np.abs(along).min() < 0.1:
        return None
    points = knuckles * ((normal @ shift[:, 0]) / along)[:, None]
    width = WIDTH_OF_KNUCKLES * float(np.linalg.norm(points[1] - points[0]))
    return width if NARROWEST_MM < width < WIDEST_MM else None


def agreed(widths: list[float]) -> float | None:
    """Returns the median of measured widths [mm], or None for too few, or for ones that differ too much."""
    least_samples = 30
    most_spread = 0.06
    if len(widths) < least_samples:
        return None
    low, middle, high = np.percentile(widths, [20, 50, 80]).tolist()
    return float(middle) if math.isfinite(middle) and high - low < most_spread * middle else None

"""The lens of a camera: where a landmark of the image lies in the image plane at distance 1."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

MODELS = "plumb_bob", "rational_polynomial"  # of camera_calibration; it also has one of fish-eye lenses


class WebcamError(Exception):
    """The program cannot start or continue; the text is one sentence for the user."""


@dataclass(frozen=True)
class WebcamLens:
    """Pinhole with distortion, for images of any size of the same shape; lengths in widths of the image."""

    matrix: np.ndarray  # shape (3, 3)
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))  # as OpenCV has it

    def rays(self, landmarks: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Returns the rays of landmarks, shape (n, 2) [0 to 1], of an image of a shape (height, width)."""
        points = landmarks * [1.0, shape[0] / shape[1]]
        return cv2.undistortPoints(points[:, None], self.matrix, self.distortion)[:, 0]

    def landmarks(self, points: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Returns where points in camera axes, shape (n, 3), are in an image, shape (n, 2) [0 to 1]."""
        seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), self.matrix, self.distortion)[0][:, 0]
        return seen / [1.0, shape[0] / shape[1]]


def lens_of_view(angle: float, shape: tuple[int, ...]) -> WebcamLens:
    """Returns the lens without distortion that sees `angle` [rad] from left to right, for images of a shape."""
    focal = 0.5 / math.tan(0.5 * angle)
    return WebcamLens(np.array([[focal, 0.0, 0.5], [0.0, focal, 0.5 * shape[0] / shape[1]], [0.0, 0.0, 1.0]]))


def lens_of_calibration(values: Any) -> WebcamLens:
    """Returns the lens of a calibration, as camera_calibration stores it. Raises WebcamError if it cannot be used."""
    coefficients = (4,), (5,), (8,), (12,), (14,)  # numbers that OpenCV takes
    try:
        matrix = np.array(values["camera_matrix"]["data"], dtype=float).reshape(3, 3) * (1.0 / values["image_width"])
        distortion = np.array(values["distortion_coefficients"]["data"], dtype=float)
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise WebcamError(f"The camera's calibration cannot be used: {type(error).__name__} {error}.") from error
    model = values.get("distortion_model", MODELS[0])
    if model not in MODELS or distortion.shape not in coefficients:
        kind = f"distortion_model is {model!r} with {distortion.size} coefficients"
        raise WebcamError(f"The camera's calibration cannot be used: {kind}, not {' or '.join(MODELS)}.")
    matrix[2, 2] = 1.0
    if not (np.isfinite(matrix).all() and np.isfinite(distortion).all() and 0.2 < matrix[0, 0] < 10.0):
        raise WebcamError(f"The camera's calibration cannot be used: its focal length is {matrix[0, 0]:g} widths.")
    return WebcamLens(matrix, distortion)

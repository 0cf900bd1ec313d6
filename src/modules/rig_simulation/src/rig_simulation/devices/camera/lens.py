"""From a pinhole image to the image of a camera with distortion.

The renderer has pinhole cameras only. A lens defines the pinhole window that contains the camera's view, and for each
pixel of the camera its position in that window. Windows come from OpenGL: their rows run from the bottom up.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel

MARGIN_PX = 4
"""Margin of the window around the camera's view, for interpolation and for the jitter of edges."""


@dataclass(frozen=True)
class PixelWindow:
    """A pinhole image plane."""

    width: int  # of the image [px]
    height: int  # of the image [px]
    # Its borders in the plane one metre in front of the camera, y up [m]
    left: float
    right: float
    bottom: float
    top: float


class CameraLens:
    """Maps the window's image to the camera's.

    Args:
        camera: the camera to imitate.
        sample_offset: position of the window's samples in their pixels, right and up from the centre [px].
    """

    def __init__(self, camera: CameraModel, sample_offset: tuple[float, float] = (0.0, 0.0)) -> None:
        self.camera = camera
        focal, centre = np.diag(camera.K)[:2], camera.K[:2, 2]
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        # On the camera's own pixel grid: no interpolation without distortion.
        straight = camera.rays(np.stack((u, v), axis=-1))[..., :2] * focal + centre
        low = np.floor(straight.min(axis=(0, 1))) - MARGIN_PX
        high = np.ceil(straight.max(axis=(0, 1))) + MARGIN_PX
        width, height = (high - low + 1.0).astype(int)
        left, top = (low - 0.5 - centre) / focal
        right, bottom = (high + 0.5 - centre) / focal
        self.window = PixelWindow(int(width), int(height), left, right, -bottom, -top)
        columns = straight[..., 0] - low[0] - sample_offset[0]
        rows = high[1] - straight[..., 1] - sample_offset[1]
        self._smooth = cv2.convertMaps(columns.astype(np.float32), rows.astype(np.float32), cv2.CV_16SC2)
        self._nearest = np.stack((np.rint(columns), np.rint(rows)), axis=-1).astype(np.int16)

    def distort(self, image: np.ndarray) -> np.ndarray:
        """Returns the camera's image, interpolated from the window's.

        Args:
            image: shape (window.height, window.width[, 3]), rows from the bottom.
        """
        positions, fractions = self._smooth
        return cv2.remap(image, positions, fractions, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def distort_nearest(self, image: np.ndarray, shift: np.ndarray | np.int16) -> np.ndarray:
        """Returns the camera's image of nearest pixels, each `shift` beside its own position.

        Args:
            image: shape (window.height, window.width[, 3]), rows from the bottom.
            shift: to the right and up, shape (height, width, 2) or one number for all, int16 [px].
        """
        nothing = np.empty(0, np.uint16)
        return cv2.remap(image, self._nearest + shift, nothing, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)

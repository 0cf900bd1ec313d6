"""From a pinhole picture to the camera's own: where each pixel of a camera with distortion finds its light.

The renderer only knows pinholes. A lens states the pinhole window that holds everything the camera sees, and for each
of the camera's pixels the place in that window. Windows come from OpenGL: their rows run from the bottom up.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel

MARGIN_PX = 4
"""Of the window around what the camera sees: room for interpolation and for the jitter of edges."""


@dataclass(frozen=True)
class PixelWindow:
    """A pinhole picture plane.

    Attributes:
        width, height: of the picture [px].
        left, right, bottom, top: its borders in the plane one metre in front of the camera, y up [m].
    """

    width: int
    height: int
    left: float
    right: float
    bottom: float
    top: float


class CameraLens:
    """Maps the window's picture to the camera's.

    Args:
        camera: the camera to imitate.
        sample_offset: where in its pixel the window's picture shows the scene, right and up from the centre [px].
    """

    def __init__(self, camera: CameraModel, sample_offset: tuple[float, float] = (0.0, 0.0)) -> None:
        self.camera = camera
        focal, centre = np.diag(camera.K)[:2], camera.K[:2, 2]
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        # On the camera's own grid of pixels: without distortion, nothing has to be interpolated.
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

    def look(self, picture: np.ndarray) -> np.ndarray:
        """Returns the camera's picture of the window's picture, interpolated.

        Args:
            picture: shape (window.height, window.width[, 3]), rows from the bottom.
        """
        places, fractions = self._smooth
        return cv2.remap(picture, places, fractions, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def look_beside(self, picture: np.ndarray, shift: np.ndarray | np.int16) -> np.ndarray:
        """Returns the camera's picture, each pixel taken whole from a place `shift` beside its own.

        Args:
            picture: shape (window.height, window.width[, 3]), rows from the bottom.
            shift: to the right and up, shape (height, width, 2) or one number for all, int16 [px].
        """
        nothing = np.empty(0, np.uint16)
        return cv2.remap(picture, self._nearest + shift, nothing, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)

"""The view for a headset: one picture for each eye, from the colour camera and, where there is one, its depth.

    colour, depth -> rectified -> one picture for each eye -> age if it is old -> lens -> screen

Everything that depends on the camera alone is computed once.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel
from vision.stereo.config import StereoViewConfig
from vision.stereo.depth_rendering import LEFT, RIGHT, eye_map, inverse_depth, shifted
from vision.stereo.image_age import mark_age
from vision.stereo.lens import Lens, Plain


@dataclass(frozen=True, eq=False)
class EyePictures:
    """What the two eyes see.

    Attributes:
        left, right: shape (height, width, 3), uint8, red first, of a rectified camera at each eye.
        deep: whether they differ by depth, rather than by one shift for the whole picture.
    """

    left: np.ndarray
    right: np.ndarray
    deep: bool

    def aged(self, age: float | None) -> EyePictures:
        """Returns the pictures marked with their age [s]."""
        return EyePictures(mark_age(self.left, age), mark_age(self.right, age), self.deep)


class StereoView:
    """Makes the eyes' pictures of one camera.

    Args:
        rgb: colour camera, of raw pictures; depth must be in its pixels.
        config: settings.

    Attributes:
        camera: the rectified camera that each eye's picture seems to come from.
        screen: draws both eyes' pictures on one screen.
    """

    def __init__(self, rgb: CameraModel, config: StereoViewConfig) -> None:
        self.camera = rgb.rectified()
        self._config = config
        self._maps = cv2.initUndistortRectifyMap(
            rgb.K, rgb.D, rgb.R, self.camera.K, (rgb.width, rgb.height), cv2.CV_16SC2
        )
        self._half_fb = 0.5 * self.camera.K[0, 0] * config.eye_distance
        self.screen: Plain | Lens
        if config.lens == "none":
            self.screen = Plain(self.camera)
        else:
            self.screen = Lens(self.camera, config.magnification, config.chromatic)

    @property
    def tangents(self) -> tuple[float, float, float, float]:
        """The edges of each eye's picture: tan(angle) to the left, right, up and down."""
        K, width, height = self.camera.K, self.camera.width, self.camera.height
        left, up = (K[0, 2] + 0.5) / K[0, 0], (K[1, 2] + 0.5) / K[1, 1]
        return left, width / K[0, 0] - left, up, height / K[1, 1] - up

    def eyes(self, colour: np.ndarray, depth: np.ndarray | None) -> EyePictures:
        """Returns both eyes' pictures.

        Args:
            colour: raw, shape (height, width, 3), uint8, red first.
            depth: of the same pixels, shape (height, width) [m], NaN = none; None: the picture is flat, and hangs where
                the settings say, or has no shift at all where they want no depth.

        Raises:
            ValueError: a picture is not of the camera's size.
        """
        size = (self.camera.height, self.camera.width)
        for name, picture in (("colour", colour), ("depth", depth)):
            if picture is not None and picture.shape[:2] != size:
                raise ValueError(f"the {name} picture has the shape {picture.shape}, but the camera's is {size}")
        flat = cv2.remap(colour, *self._maps, cv2.INTER_LINEAR)
        if depth is None:
            shift = round(self._half_fb / self._config.flat_distance) if self._config.depth else 0
            return EyePictures(_moved(flat, shift), _moved(flat, -shift), False)
        # No blend between an edge and the wall behind it.
        z = cv2.remap(depth, *self._maps, cv2.INTER_NEAREST, borderValue=(float("nan"),))
        shift = self._half_fb * inverse_depth(z, self._config.nearest, self._config.flat_distance)
        left, right = (shifted(flat, eye_map(shift, eye)) for eye in (LEFT, RIGHT))
        return EyePictures(left, right, True)


def _moved(picture: np.ndarray, columns: int) -> np.ndarray:
    """Returns the picture moved to the right by so many columns, black where it came from."""
    columns = int(np.clip(columns, -picture.shape[1], picture.shape[1]))
    moved = np.zeros_like(picture)
    if columns >= 0:
        moved[:, columns:] = picture[:, : picture.shape[1] - columns]
    else:
        moved[:, :columns] = picture[:, -columns:]
    return moved

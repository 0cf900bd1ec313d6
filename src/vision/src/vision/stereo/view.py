"""The headset view: one image for each eye, from the colour camera and its depth if available.

    colour, depth -> rectified -> one image for each eye -> mark of its age if it is old -> lens -> screen

Everything that depends on the camera alone is computed once.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel
from vision.stereo.config import StereoViewConfig
from vision.stereo.depth_rendering import LEFT, RIGHT, eye_map, inverse_depth, shifted
from vision.stereo.lens import Dk2Lens, NoLens

DARK = 0.4
"""Brightness of a marked image."""
FONT = cv2.FONT_HERSHEY_SIMPLEX
COLOUR = (255, 200, 60)


@dataclass(frozen=True, eq=False)
class EyeImages:
    """The images for the two eyes."""

    left: np.ndarray  # RGB, shape (height, width, 3), uint8, of a rectified camera at each eye
    right: np.ndarray  # RGB, shape (height, width, 3), uint8, of a rectified camera at each eye
    deep: bool  # whether they differ by depth, rather than by one shift of the whole image

    def aged(self, age: float | None) -> EyeImages:
        """Returns the images marked with their age [s]."""
        return EyeImages(mark_age(self.left, age), mark_age(self.right, age), self.deep)


class StereoView:
    """Makes the eye images of one camera.

    Args:
        rgb: model of the colour camera with raw images; depth must be in its pixels.

    Attributes:
        camera: the rectified camera of each eye image.
        screen: draws both eye images on one screen.
    """

    def __init__(self, rgb: CameraModel, config: StereoViewConfig) -> None:
        self.camera = rgb.rectified()
        self._config = config
        size = (rgb.width, rgb.height)
        self._maps = cv2.initUndistortRectifyMap(rgb.K, rgb.D, rgb.R, self.camera.K, size, cv2.CV_16SC2)
        self._half_fb = 0.5 * self.camera.K[0, 0] * config.eye_distance
        self.screen: NoLens | Dk2Lens
        if config.lens == "none":
            self.screen = NoLens(self.camera)
        else:
            self.screen = Dk2Lens(self.camera, config.magnification, config.chromatic)

    @property
    def tangents(self) -> tuple[float, float, float, float]:
        """The edges of each eye image: tan(angle) to the left, right, up and down."""
        K, width, height = self.camera.K, self.camera.width, self.camera.height
        left, up = (K[0, 2] + 0.5) / K[0, 0], (K[1, 2] + 0.5) / K[1, 1]
        return left, width / K[0, 0] - left, up, height / K[1, 1] - up

    def eyes(self, colour: np.ndarray, depth: np.ndarray | None) -> EyeImages:
        """Returns both eye images.

        Args:
            colour: raw RGB image, shape (height, width, 3), uint8.
            depth: in the same pixels, shape (height, width) [m], NaN where unknown. None: the image is flat and appears
                at the configured distance, or is not shifted at all if the configuration disables depth.

        Raises:
            ValueError: an image does not have the camera's size.
        """
        size = (self.camera.height, self.camera.width)
        for name, image in (("colour", colour), ("depth", depth)):
            if image is not None and image.shape[:2] != size:
                raise ValueError(f"the {name} image has the shape {image.shape}, but camera_info says {size}")
        flat = cv2.remap(colour, *self._maps, cv2.INTER_LINEAR)
        if depth is None:
            shift = round(self._half_fb / self._config.flat_distance) if self._config.depth else 0
            return EyeImages(_moved(flat, shift), _moved(flat, -shift), False)
        # Nearest neighbour: interpolation would blend an edge with the wall behind it.
        z = cv2.remap(depth, *self._maps, cv2.INTER_NEAREST, borderValue=(float("nan"),))
        shift = self._half_fb * inverse_depth(z, self._config.nearest, self._config.flat_distance)
        left, right = (shifted(flat, eye_map(shift, eye)) for eye in (LEFT, RIGHT))
        return EyeImages(left, right, True)


class ImageAge:
    """Measures the time since the arrival of the image that is shown."""

    def __init__(self) -> None:
        self._stamp: float | None = None
        self._since: float | None = None

    def is_new(self, stamp: float) -> bool:
        """Returns whether an image with this stamp [s] differs from the one shown: a frozen camera repeats its last."""
        return stamp != self._stamp

    def shown(self, stamp: float, since: float) -> None:
        """Records that an image with this stamp [s], which arrived at the time `since` [s], is shown from now on."""
        self._stamp, self._since = stamp, since

    def age(self, now: float) -> float | None:
        """Returns the time since the arrival of the image that is shown [s]; None before the first."""
        return None if self._since is None else now - self._since


def age_text(age: float | None) -> str:
    """Returns the text for an image's age [s]."""
    if age is None:
        return "no image yet"
    return f"{age:.1f} s old" if age < 60.0 else f"{age / 60.0:.0f} min old"


def mark_age(image: np.ndarray, age: float | None) -> np.ndarray:
    """Returns the image, shape (height, width, 3), darkened and with its age [s] in the middle."""
    marked = cv2.convertScaleAbs(image, alpha=DARK)
    height, width = image.shape[:2]
    text = age_text(age)
    scale = width / 400.0
    thickness = max(1, round(2.0 * scale))
    (length, tall), _ = cv2.getTextSize(text, FONT, scale, thickness)
    cv2.putText(marked, text, ((width - length) // 2, (height + tall) // 2), FONT, scale, COLOUR, thickness)
    return marked


def _moved(image: np.ndarray, columns: int) -> np.ndarray:
    """Returns the image moved to the right by some columns, with black behind it."""
    shift = np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]])
    return cv2.warpAffine(image, shift, image.shape[1::-1], flags=cv2.INTER_NEAREST)

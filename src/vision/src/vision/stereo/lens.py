"""Corrects the lens distortion of the Rift DK2 by maps that are computed once. A display pixel (u, v), counted from the
upper left corner of its half with pixel centres at +0.5, appears in the direction (x s, y s, 1) with x = (u - cx) pitch
/ SCALE, y likewise, and s a polynomial in r2 = x^2 + y^2; red is bent less and blue more than green. Directions are
those of an optical frame: x right, y down, z forward. The polynomial is a fit (error 0.003) to the spline of the Oculus
SDK 0.5; the colour factors hold for 12 mm between lens and eye."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from common.camera_model import CameraModel

WIDTH, HEIGHT = 960, 1080  # size of one eye's half of the screen [px]
CENTRES = ((475.3, 540.0), (484.7, 540.0))  # centres of the left and the right lens, each in its own half [px]
RED, GREEN, BLUE = range(3)
COLOURS = ((-0.0127, -0.017), (0.0, 0.0), (0.0212, 0.017))  # red, green, blue: constant and r2 part beyond 1


def directions(pixels: ArrayLike, eye: int, colour: int = GREEN) -> np.ndarray:
    """Returns tan(angle) to the right and down, shape (..., 2), at which display pixels, shape (..., 2), centres at
    +0.5 [px], appear to the `eye` (0 = left, 1 = right) in a colour (RED, GREEN or BLUE)."""
    pitch_m = 0.12576 / 1920
    scale_m = 0.036  # length on the screen per unit of tan(angle), at the centre
    radial = (1.0, 0.2083, -0.0064, 0.1759)
    xy = (np.asarray(pixels, dtype=float) - CENTRES[eye]) * (pitch_m / scale_m)
    r2 = (xy * xy).sum(axis=-1, keepdims=True)
    constant, with_r2 = COLOURS[colour]
    return xy * np.polyval(radial[::-1], r2) * (1.0 + constant + with_r2 * r2)


@dataclass(frozen=True, eq=False)
class _EyeMaps:
    rows: slice
    columns: slice
    maps: tuple[tuple[np.ndarray, np.ndarray], ...]


class Dk2Lens:
    """Draws the images of eyes with the rectified `camera` as the screen of the Rift DK2 must show them. The
    magnification 1 shows true angles; `chromatic` bends each colour separately."""

    width, height = 2 * WIDTH, HEIGHT

    def __init__(self, camera: CameraModel, magnification: float, chromatic: bool) -> None:
        colours = (RED, GREEN, BLUE) if chromatic else (GREEN,)
        self._eyes = [_eye_maps(camera, magnification, eye, colours) for eye in (0, 1)]

    def draw(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Returns the screen, shape (1080, 1920, 3), from the RGB eye images, shape (height, width, 3)."""
        screen = np.zeros((self.height, self.width, 3), np.uint8)
        for eye, image in enumerate((left, right)):
            area = self._eyes[eye]
            half = screen[area.rows, eye * WIDTH : (eye + 1) * WIDTH][:, area.columns]
            if len(area.maps) == 1:
                half[:] = cv2.remap(image, *area.maps[0], cv2.INTER_LINEAR)
            else:
                channels = zip(cv2.split(image), area.maps)
                half[:] = cv2.merge([cv2.remap(channel, *maps, cv2.INTER_LINEAR) for channel, maps in channels])
        return screen


class NoLens:
    """Puts the unchanged eye images side by side, for a viewer that corrects its own lenses."""

    def __init__(self, camera: CameraModel) -> None:
        self.width, self.height = 2 * camera.width, camera.height

    def draw(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Returns both images, shape (height, 2 width, 3)."""
        return np.hstack((left, right))


def _eye_maps(camera: CameraModel, magnification: float, eye: int, colours: tuple[int, ...]) -> _EyeMaps:
    """Returns the maps of that part of an eye's half in which some colour shows something of the camera image."""
    pixels = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), axis=-1)
    found = [
        (directions(pixels, eye, colour) / magnification * (camera.K[0, 0], camera.K[1, 1]) + camera.K[:2, 2])
        for colour in colours
    ]
    visible = np.zeros((HEIGHT, WIDTH), bool)
    for uv in found:
        visible |= ((uv > -1.0) & (uv < (camera.width, camera.height))).all(axis=-1)
    rows, columns = _extent(visible.any(axis=1)), _extent(visible.any(axis=0))
    maps = (uv[rows, columns].astype(np.float32) for uv in found)
    return _EyeMaps(rows, columns, tuple(cv2.convertMaps(m[..., 0], m[..., 1], cv2.CV_16SC2) for m in maps))


def _extent(mask: np.ndarray) -> slice:
    indices = np.flatnonzero(mask)
    return slice(int(indices[0]), int(indices[-1]) + 1) if len(indices) else slice(0, 1)

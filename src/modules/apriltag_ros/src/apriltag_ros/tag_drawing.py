"""Drawings of tags as the camera would show them, to be compared with its picture.

Every pixel is the mean of samples, each of which looks through the lens at the plane of the tag; the whole is blurred
in the picture's plane. The derivatives by the pose follow from the drawing's own slopes: what a change of the pose does
is to move each point of the tag in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from apriltag_ros.tag_pose import corner_jacobian
from apriltag_ros.target import TagPlace
from common.camera_model import CameraModel

RING = 0.5
"""So much of the white ring round the black square is compared, in cells."""
PAPER = 2
"""So many white cells round the black square are drawn."""
SUB = 4
"""Samples along each edge of a pixel."""
SAMPLES = (2, 64)
"""Fewest and most pixels of the bitmap along a cell."""
BLURS_PX = (0.2, 4.0)
"""Smallest and greatest standard deviation of the point spread."""
BLUR_STEP_PX = 0.02


class Pattern:
    """A tag's pattern: 1 where it is white, 0 where black."""

    def __init__(self, tag: TagPlace, black: np.ndarray) -> None:
        self.tag, self.cells = tag, len(black)
        self.white = np.pad(~black, PAPER, constant_values=True).astype(np.float32)

    def bitmap(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the pattern with so many pixels a cell, and the matrix, shape (3, 3), from x, y, 1 in the tag's plane
        [m] to its pixels."""
        scale = samples * self.cells / self.tag.size
        middle = samples * (self.cells / 2.0 + PAPER) - 0.5
        A = np.array([[scale, 0.0, middle], [0.0, -scale, middle], [0.0, 0.0, 1.0]])
        return cv2.resize(self.white, None, fx=samples, fy=samples, interpolation=cv2.INTER_NEAREST), A


@dataclass(frozen=True, eq=False)
class TagView:
    """The part of the picture round one tag.

    Attributes:
        T_target_tag: shape (4, 4) [m].
        bitmap: the pattern, shape (b, b).
        A: from x, y, 1 in the tag's plane to the bitmap's pixels, shape (3, 3).
        rays: directions x, y of the samples, shape (SUB h, SUB w, 2).
        compared: pixels that count, shape (h, w), bool; n of them.
        grey: what the camera saw there, shape (n,).
        directions: x, y, 1 of these pixels, shape (n, 3).
        to_pixels: derivative of the pixel by the direction, shape (n, 2, 2).
    """

    T_target_tag: np.ndarray
    bitmap: np.ndarray
    A: np.ndarray
    rays: np.ndarray
    compared: np.ndarray
    grey: np.ndarray
    directions: np.ndarray
    to_pixels: np.ndarray

    @staticmethod
    def of(pattern: Pattern, grey: np.ndarray, camera: CameraModel, T_start: np.ndarray) -> TagView | None:
        """Returns the view, or None if the tag with its ring is not wholly in the picture."""
        T = T_start @ pattern.tag.T_target_tag
        half = pattern.tag.size * (0.5 + RING / pattern.cells)
        area = _area(T, half, camera)
        if area is None:
            return None
        u, v = area
        rays = camera.rays(np.stack(np.meshgrid(u, v), axis=-1))
        plane = rays @ np.linalg.inv(T[:3, [0, 1, 3]]).T
        compared = np.all(np.abs(plane[..., :2]) <= half * plane[..., 2:], axis=-1)
        rows, columns = np.nonzero(compared)
        across, down = np.gradient(rays[..., :2], axis=1), np.gradient(rays[..., :2], axis=0)
        cell = camera.K[0, 0] * pattern.tag.size / pattern.cells / T[2, 3]
        bitmap, A = pattern.bitmap(int(np.clip(np.rint(SUB * cell), *SAMPLES)))
        return TagView(
            T_target_tag=pattern.tag.T_target_tag,
            bitmap=bitmap,
            A=A,
            rays=cv2.resize(rays[..., :2].astype(np.float32), None, fx=SUB, fy=SUB, interpolation=cv2.INTER_LINEAR),
            compared=compared,
            grey=grey[v[rows], u[columns]].astype(float),
            directions=rays[compared],
            to_pixels=np.linalg.inv(np.stack((across[compared], down[compared]), axis=-1)),
        )

    def draw(self, T_camera_target: np.ndarray, blur: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns the drawing of the pixels that count, shape (n,), 0 black to 1 white, and its derivatives by pose and
        blur, shape (n, 7)."""
        T = T_camera_target @ self.T_target_tag
        M = np.linalg.inv(T[:3, [0, 1, 3]])
        places = cv2.transform(self.rays, (self.A @ M).astype(np.float32))
        places = places[..., :2] / places[..., 2:]
        crisp = cv2.remap(  # type: ignore[call-overload]  # cv2's types do not know that both maps may be in one array
            self.bitmap, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        soft = cv2.GaussianBlur(crisp, (0, 0), SUB * blur, borderType=cv2.BORDER_REPLICATE)
        softer = cv2.GaussianBlur(crisp, (0, 0), SUB * (blur + BLUR_STEP_PX), borderType=cv2.BORDER_REPLICATE)
        shown, across, down, change = (
            self._pixels(part)
            for part in (
                soft,
                cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=1, scale=0.5 * SUB),
                cv2.Sobel(soft, cv2.CV_32F, 0, 1, ksize=1, scale=0.5 * SUB),
                (softer - soft) / BLUR_STEP_PX,
            )
        )
        plane = self.directions @ M.T
        local = np.column_stack((plane[:, :2] / plane[:, 2:], np.zeros(len(plane))))
        points = local @ self.T_target_tag[:3, :3].T + self.T_target_tag[:3, 3]
        moves = self.to_pixels @ corner_jacobian(T_camera_target, points, np.eye(3))
        J = -np.einsum("ni,nij->nj", np.stack((across, down), axis=1), moves)
        return shown, np.column_stack((J, change))

    def _pixels(self, fine: np.ndarray) -> np.ndarray:
        h, w = self.compared.shape
        return cv2.resize(fine, (w, h), interpolation=cv2.INTER_AREA)[self.compared].astype(float)


def _area(T: np.ndarray, half: float, camera: CameraModel) -> tuple[np.ndarray, np.ndarray] | None:
    """Returns the columns and rows of the picture round the square from -half to half [m] in the plane of T, with room
    for the blur; None if the square is not wholly in the picture."""
    grid = np.linspace(-half, half, 5)
    seen = np.array([(x, y, 0.0) for x in grid for y in grid]) @ T[:3, :3].T + T[:3, 3]
    if np.any(seen[:, 2] <= 0.0):
        return None
    pixels, size = camera.project(seen), np.array([camera.width, camera.height])
    low, high = np.floor(pixels.min(axis=0)).astype(int), np.ceil(pixels.max(axis=0)).astype(int)
    if np.any(low < 0) or np.any(high > size - 1):
        return None
    room = int(np.ceil(3.0 * BLURS_PX[1]))
    low, high = np.maximum(low - room, 0), np.minimum(high + room, size - 1)
    return np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)

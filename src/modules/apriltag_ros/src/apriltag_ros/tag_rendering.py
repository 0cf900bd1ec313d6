"""Renders tags as the camera would see them, for comparison with its image. A pixel is the mean of samples, each a ray
through the lens to the plane of the tag; the result is blurred in the image plane. The derivatives by the pose follow
from the gradient of the rendered image: a change of the pose moves each point of the tag in the image."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache

import apriltag
import cv2
import numpy as np

from apriltag_ros.settings import FAMILIES, TargetTag
from apriltag_ros.tag_pose import corner_jacobian
from common.camera_model import CameraModel

PAPER = 2
"""Width of the white margin that is rendered [cells]."""
SUB = 4
"""Samples along each edge of a pixel."""
BLURS_PX = (0.2, 4.0)
"""Limits of the standard deviation of the point spread."""


class TagPattern:
    """The pattern of a tag: 1 is white, 0 is black."""

    def __init__(self, tag: TargetTag, black: np.ndarray) -> None:
        self.tag, self.cells = tag, len(black)
        self.white = np.pad(~black, PAPER, constant_values=True).astype(np.float32)

    def bitmap(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the pattern with `samples` pixels a cell, and the matrix, shape (3, 3), from x, y, 1 in the tag's
        plane [m] to its pixels."""
        scale = samples * self.cells / self.tag.size
        middle = samples * (self.cells / 2.0 + PAPER) - 0.5
        A = np.array([[scale, 0.0, middle], [0.0, -scale, middle], [0.0, 0.0, 1.0]])
        return cv2.resize(self.white, None, fx=samples, fy=samples, interpolation=cv2.INTER_NEAREST), A


@dataclass(frozen=True, eq=False)
class TagView:
    """The part of the image round one tag."""

    T_target_tag: np.ndarray  # pose of the tag, shape (4, 4) [m]
    bitmap: np.ndarray  # the pattern, shape (b, b)
    A: np.ndarray  # matrix from x, y, 1 in the tag's plane to the bitmap's pixels, shape (3, 3)
    rays: np.ndarray  # directions x, y of the samples, shape (SUB h, SUB w, 2)
    compared: np.ndarray  # mask of the n compared pixels, shape (h, w), bool
    grey: np.ndarray  # their grey values, shape (n,)
    directions: np.ndarray  # their rays x, y, 1, shape (n, 3)
    to_pixels: np.ndarray  # derivative of the pixel by the direction, shape (n, 2, 2)

    @staticmethod
    def of(pattern: TagPattern, grey: np.ndarray, camera: CameraModel, T_start: np.ndarray) -> TagView | None:
        """Returns the view, or None if the image cuts off the tag or its ring."""
        # Width of the white ring round the black square that is compared [cells].
        ring = 0.5
        # Limits of the bitmap pixels along a cell.
        samples = (2, 64)
        T = T_start @ pattern.tag.T_target_tag
        half = pattern.tag.size * (0.5 + ring / pattern.cells)
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
        bitmap, A = pattern.bitmap(int(np.clip(np.rint(SUB * cell), *samples)))
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

    def render(self, T_camera_target: np.ndarray, blur: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns the rendered values of the compared pixels, shape (n,), 0 black to 1 white, and their derivatives by
        pose and blur, shape (n, 7)."""
        blur_step_px = 0.02
        T = T_camera_target @ self.T_target_tag
        M = np.linalg.inv(T[:3, [0, 1, 3]])
        places = cv2.transform(self.rays, (self.A @ M).astype(np.float32))
        places = places[..., :2] / places[..., 2:]
        crisp = cv2.remap(  # type: ignore[call-overload]  # the type stubs demand two maps
            self.bitmap, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        soft = cv2.GaussianBlur(crisp, (0, 0), SUB * blur, borderType=cv2.BORDER_REPLICATE)
        softer = cv2.GaussianBlur(crisp, (0, 0), SUB * (blur + blur_step_px), borderType=cv2.BORDER_REPLICATE)
        values, across, down, change = (
            self._pixels(part)
            for part in (
                soft,
                cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=1, scale=0.5 * SUB),
                cv2.Sobel(soft, cv2.CV_32F, 0, 1, ksize=1, scale=0.5 * SUB),
                (softer - soft) / blur_step_px,
            )
        )
        plane = self.directions @ M.T
        local = np.column_stack((plane[:, :2] / plane[:, 2:], np.zeros(len(plane))))
        points = local @ self.T_target_tag[:3, :3].T + self.T_target_tag[:3, 3]
        moves = self.to_pixels @ corner_jacobian(T_camera_target, points, np.eye(3))
        J = -np.einsum("ni,nij->nj", np.stack((across, down), axis=1), moves)
        return values, np.column_stack((J, change))

    def _pixels(self, fine: np.ndarray) -> np.ndarray:
        h, w = self.compared.shape
        return cv2.resize(fine, (w, h), interpolation=cv2.INTER_AREA)[self.compared].astype(float)


def _area(T: np.ndarray, half: float, camera: CameraModel) -> tuple[np.ndarray, np.ndarray] | None:
    """Returns the image columns and rows round the square from -half to half [m] in the plane of T, with a margin for
    the blur; None if the image cuts off the square."""
    grid = np.linspace(-half, half, 5)
    points = np.array([(x, y, 0.0) for x in grid for y in grid]) @ T[:3, :3].T + T[:3, 3]
    if np.any(points[:, 2] <= 0.0):
        return None
    pixels, size = camera.project(points), np.array([camera.width, camera.height])
    low, high = np.floor(pixels.min(axis=0)).astype(int), np.ceil(pixels.max(axis=0)).astype(int)
    if np.any(low < 0) or np.any(high > size - 1):
        return None
    margin = int(np.ceil(3.0 * BLURS_PX[1]))
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, size - 1)
    return np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    return apriltag.Detector().libc


@lru_cache(maxsize=None)
def black_cells(family: str, tag: int) -> np.ndarray:
    """Returns which cells of the black square of a tag are black, top row first, shape (n, n), bool; raises ValueError
    if the family, one of FAMILIES, has no such tag."""
    if family not in FAMILIES:
        raise ValueError(f"unknown tag family {family}; use one of {', '.join(FAMILIES)}")
    table = _library().apriltag_family_create(family.encode()).contents
    if not 0 <= tag < table.ncodes:
        raise ValueError(f"tag id {tag} is not in the family {family}, which has 0 to {table.ncodes - 1}")
    edge, border, code = table.d, table.black_border, table.codes[tag]
    white = [code >> (edge * edge - 1 - i) & 1 for i in range(edge * edge)]
    black = np.pad(~np.array(white, dtype=bool).reshape(edge, edge), border, constant_values=True)
    black.flags.writeable = False
    return black

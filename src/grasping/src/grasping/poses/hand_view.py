"""What a depth image shows around a grasp, as the network of `lift_network` takes it, in the hand's own frame.

At points between, at and beside the fingers: how far each lies behind (above 0) or before the surface that is seen
there. So a finger's place that is free is negative, and the thing between the fingers positive. Further out only the
surface's height beside the grasp counts: how far the thing reaches, and on which side.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from common.camera_model import CameraModel
from grasping.network.depth_image import NetworkImage
from grasping.poses.candidates import LevelFrame
from grasping.poses.gripper import Gripper
from grasping.poses.hypotheses import Hypotheses, pixel_matrix

BETWEEN = (-0.95, -0.65, -0.3, 0.0, 0.3, 0.65, 0.95)  # across, as fractions of half the opening
BESIDE = (0.125, 0.625, 1.5)  # beyond a pad's face, in thicknesses of a finger
ALONG = (-0.8, -0.4, 0.0, 0.4, 0.8)  # in breadths of a finger
DOWN_M = (-0.055, -0.035, -0.022, -0.014, -0.007, -0.002, 0.004)  # from the tips
NEAR_M = 0.015  # distance from the surface that counts as 1
AROUND_M = (-0.105, -0.075, -0.045, -0.015, 0.015, 0.045, 0.075, 0.105)
FAR_M = 0.05
LARGEST = 3.0  # of any feature
SCALARS = 10


FEATURES = (len(BETWEEN) + 2 * len(BESIDE)) * len(ALONG) * len(DOWN_M) + len(AROUND_M) ** 2 + SCALARS


def features(
    of: Hypotheses, image: NetworkImage, camera: CameraModel, frame: LevelFrame, gripper: Gripper
) -> np.ndarray:
    """Returns the network's input for each hypothesis, shape (n, FEATURES), float32, about -1 to 1."""
    half = 0.5 * np.maximum(of.opening, gripper.least)[:, None]
    R, down = of.T[:, :3, :3].astype(np.float32), frame.R[:, 2].astype(np.float32)
    tips = of.T[:, :3, 3].astype(np.float32) + gripper.reach * R[:, :, 2]
    low = np.clip(gripper.ground - (frame.distance - tips @ down), 0.0, 2.0 * gripper.reach)
    tips = tips - (low / np.maximum(R[:, :, 2] @ down, 0.3))[:, None] * R[:, :, 2]
    origin = tips - gripper.reach * R[:, :, 2]
    found, near = np.empty((len(R), FEATURES), np.float32), _around_fingers(gripper)
    local, wide, other = np.split(found, (near.shape[1], FEATURES - SCALARS), axis=1)
    x, y, z = np.moveaxis(R, 2, 0)
    _behind(np.stack([half * x, x, y, z, origin], axis=1), near, image, camera, NEAR_M, local)
    # In the plane across the vertical, turned with the line through the fingers.
    x, y = np.moveaxis(_level_of(R, frame), 2, 0)[:2]
    _behind(np.stack([x, y, origin], axis=1), _around_hand(), image, camera, FAR_M, wide)
    scalars = np.concatenate(
        [
            of.seen,
            np.einsum("i,nij->nj", down, R),
            (of.opening[:, None] - 0.05) / 0.05,
            (frame.distance - tips @ down)[:, None] / FAR_M,
            (frame.distance - origin @ down)[:, None] / FAR_M,
            np.full((len(R), 1), image.mean - 0.7) / 0.2,
        ],
        axis=1,
    )
    np.clip(scalars, -LARGEST, LARGEST, out=other, casting="same_kind")
    return found


def mirrored(values: np.ndarray, across: bool, along: bool) -> np.ndarray:
    """Returns the features of the mirrored scene: `across`: fingers exchanged; `along`: front and back exchanged."""
    n, wide = len(values), len(AROUND_M)
    cut = FEATURES - SCALARS - wide**2
    local = values[:, :cut].reshape(n, -1, len(ALONG), len(DOWN_M))
    far, scalars = values[:, cut:-SCALARS].reshape(n, wide, wide), values[:, -SCALARS:].copy()
    if across:
        local, far = local[:, ::-1], far[:, ::-1]
        scalars[:, 3] *= -1.0
    if along:
        local, far = local[:, :, ::-1], far[:, :, ::-1]
        scalars[:, 4] *= -1.0
    return np.concatenate([local.reshape(n, -1), far.reshape(n, -1), scalars], axis=1)


def _level_of(R: np.ndarray, frame: LevelFrame) -> np.ndarray:
    """Returns the hands' orientations, laid level: z down, x as far along the line through the fingers as it can."""
    down = frame.R[:, 2].astype(np.float32)
    x = R[:, :, 0] - (R[:, :, 0] @ down)[:, None] * down
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z = np.broadcast_to(down, x.shape)
    return np.stack([x, np.cross(z, x), z], axis=-1)


@lru_cache(maxsize=4)
def _around_fingers(gripper: Gripper) -> np.ndarray:
    """Returns the points at the fingers as multiples of half the opening and the hand's axes from its origin, whose
    multiple is 1, shape (5, n), float32 [1, m, m, m, 1]."""
    beside = gripper.thickness * np.array(BESIDE)
    fractions = np.concatenate([np.full(len(BESIDE), -1.0), BETWEEN, np.full(len(BESIDE), 1.0)])
    across = np.concatenate([-beside[::-1], np.zeros(len(BETWEEN)), beside])
    which, y, z = np.meshgrid(
        np.arange(len(across)), gripper.breadth * np.array(ALONG), gripper.reach + np.array(DOWN_M), indexing="ij"
    )
    return _grid(fractions[which], across[which], y, z)


@lru_cache(maxsize=1)
def _around_hand() -> np.ndarray:
    """Returns the points further out, likewise: multiples of two axes, shape (3, n)."""
    return _grid(*np.meshgrid(AROUND_M, AROUND_M, indexing="ij"))


def _grid(*steps: np.ndarray) -> np.ndarray:
    found = np.stack([*(step.ravel() for step in steps), np.ones(steps[0].size)]).astype(np.float32)
    found.setflags(write=False)
    return found


def _behind(
    axes: np.ndarray, grid: np.ndarray, image: NetworkImage, camera: CameraModel, unit: float, found: np.ndarray
) -> None:
    """Writes how far the points of grids lie behind the surface seen there, -1 to 1, to `found`, shape (n, m) [unit];
    `axes`: of the grids and their origins, shape (n, k, 3) [m]; `grid`: the points' multiples of these, shape (k, m).
    """
    least, one, per_unit = np.float32(1e-3), np.float32(1.0), np.float32(1.0 / unit)
    part = 32  # of the hypotheses at a time, so that the processor's cache holds the points
    to_pixels = pixel_matrix(image, camera)
    to_pixels[:2] -= 0.5 * to_pixels[2]  # as OpenCV counts: whole numbers are the pixels' middles
    # Column and row of the image, both times the depth, and the depth are linear in the multiples: no point is found.
    seen = np.ascontiguousarray(np.moveaxis(axes.astype(np.float32) @ to_pixels.T.astype(np.float32), 2, 0))
    points, other = np.empty((3, part, grid.shape[1]), np.float32), np.empty((part, grid.shape[1]), np.float32)
    for first in range(0, len(axes), part):
        behind = found[first : first + part]
        count = len(behind)
        column, row, depth = np.matmul(seen[:, first : first + count], grid, out=points[:, :count])
        nearer = np.maximum(depth, least, out=other[:count])
        np.reciprocal(nearer, out=nearer)
        column *= nearer
        row *= nearer
        depth -= cv2.remap(image.depth, column, row, cv2.INTER_NEAREST, nearer, borderMode=cv2.BORDER_REPLICATE)
        depth *= per_unit
        np.maximum(depth, -one, out=depth)
        np.minimum(depth, one, out=behind)

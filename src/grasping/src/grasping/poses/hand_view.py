"""What a depth image shows around a grasp, as the network of `lift_network` takes it, in the hand's own frame.

At points between, at and beside the fingers: how far each lies behind (above 0) or before the surface that is seen
there. So a finger's place that is free is negative, and the thing between the fingers positive. Further out only the
surface's height beside the grasp counts: how far the thing reaches, and on which side.
"""

from __future__ import annotations

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
    n, half = len(of.T), 0.5 * np.maximum(of.opening, gripper.least)[:, None]
    beside, reach = gripper.thickness * np.array(BESIDE), gripper.reach
    across = np.concatenate([-half - beside[::-1], half * BETWEEN, half + beside], axis=1)  # shape (n, 13)
    y, z = gripper.breadth * np.array(ALONG), reach + np.array(DOWN_M)
    R, down = of.T[:, :3, :3].astype(np.float32), frame.R[:, 2].astype(np.float32)
    tips = of.T[:, :3, 3].astype(np.float32) + reach * R[:, :, 2]
    low = np.clip(gripper.ground - (frame.distance - tips @ down), 0.0, 2.0 * reach)
    tips = tips - (low / np.maximum(R[:, :, 2] @ down, 0.3))[:, None] * R[:, :, 2]
    origin = tips - reach * R[:, :, 2]
    local = _behind((across, y[None], z[None]), R, origin, image, camera) / NEAR_M
    around = np.array(AROUND_M)[None]
    # In the plane across the vertical, turned with the line through the fingers.
    wide = _behind((around, around), _level_of(R, frame), origin, image, camera) / FAR_M
    scalars = np.concatenate(
        [
            of.seen,
            np.einsum("i,nij->nj", down, R),
            (of.opening[:, None] - 0.05) / 0.05,
            (frame.distance - tips @ down)[:, None] / FAR_M,
            (frame.distance - origin @ down)[:, None] / FAR_M,
            np.full((n, 1), image.mean - 0.7) / 0.2,
        ],
        axis=1,
    )
    return np.concatenate(
        [np.clip(local, -1.0, 1.0), np.clip(wide, -1.0, 1.0), np.clip(scalars, -LARGEST, LARGEST)], axis=1
    ).astype(np.float32)


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


def _behind(
    steps: tuple[np.ndarray, ...], R: np.ndarray, origin: np.ndarray, image: NetworkImage, camera: CameraModel
) -> np.ndarray:
    """Returns how far the points of grids lie behind the surface seen there, shape (n, m) [m]; `steps`: along the first
    axes of each of the frames `R`, shape (n or 1, m_i) [m]."""
    side = len(image.depth)
    to_pixels = pixel_matrix(image, camera).astype(np.float32)
    axes = to_pixels @ R
    # Column and row of the image, both times the depth, and the depth: linear in the steps, so no point is computed.
    seen = (origin.astype(np.float32) @ to_pixels.T)[:, :, None]
    for axis, step in enumerate(steps):
        moved = axes[:, :, axis, None] * step[:, None].astype(np.float32)
        seen = (seen[..., None] + moved[:, :, None]).reshape(len(R), 3, -1)
    depth = seen[:, 2]
    nearer = 1.0 / np.maximum(depth, np.float32(1e-3))
    column, row = (np.clip((seen[:, i] * nearer).astype(np.int32), 0, side - 1) for i in range(2))
    behind: np.ndarray = depth - image.depth.ravel()[side * row + column]
    return behind

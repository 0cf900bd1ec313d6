"""Hypotheses of grasps in six degrees of freedom, from the whole of GGCNN's maps and the depth around.

A hypothesis is a pose in the camera's frame, z the approach and x through both fingers, its origin on or near the seen
surface, and an opening. Places are pixels of high quality, and pixels of objects where GGCNN sees nothing; at each one
the hand turns and tilts by a fixed table. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.camera_model import CameraModel
from grasping.network.depth_image import NetworkImage
from grasping.network.maps import Maps
from grasping.poses.candidates import LevelFrame, heights, image_rays

PLACES = 96
SPACING_PX = 4  # between two places, rows or columns
BORDER_PX = 20  # rows and columns at the image's border without places
OBJECT_M = 0.008  # what stands out of the table by more is an object
ABOVE_RAD, MAX_TILT_RAD = 0.02, np.pi / 4.0  # tilts of grasps from above, and the greatest one
MIN_OPENING_M = 0.01


class Turn(NamedTuple):
    """How a hypothesis differs from GGCNN's grasp at its pixel."""

    line: float = 0.0  # of the line through the fingers, anticlockwise in the image [rad]
    pitch: float = 0.0  # of the hand about that line [rad]
    roll: float = 0.0  # of that line out of the horizontal [rad]
    wider: float = 0.0  # opening [m]
    back: float = 0.0  # along the approach, away from the surface [m]


QUARTER = 0.5 * np.pi
TURNS = (
    Turn(),
    Turn(wider=0.012),
    Turn(line=0.4, back=0.008),
    Turn(line=QUARTER),
    Turn(pitch=0.45),
    Turn(pitch=-0.45),
    Turn(roll=0.4, wider=0.008),
    Turn(roll=-0.4, wider=0.008),
)
"""What is tried at each place."""
LEVEL_TURNS = tuple(turn for turn in TURNS if not turn.pitch)  # without those that from straight above are like others


class Hypotheses(NamedTuple):
    """n grasps."""

    T: np.ndarray  # T_camera_grasp, shape (n, 4, 4) [m]
    opening: np.ndarray  # shape (n,) [m]
    seen: np.ndarray  # what GGCNN says at the pixel: quality; how well its line agrees, -1 to 1; how much wider this is
    """Shape (n, 3)."""

    def part(self, chosen: np.ndarray) -> Hypotheses:
        return Hypotheses(self.T[chosen], self.opening[chosen], self.seen[chosen])


def joined(*parts: Hypotheses) -> Hypotheses:
    return Hypotheses(*(np.concatenate(values) for values in zip(*parts)))


def hypotheses(
    maps: Maps,
    certainty: np.ndarray,
    image: NetworkImage,
    camera: CameraModel,
    frame: LevelFrame,
    most_open: float,
    turns: tuple[Turn, ...] = TURNS,
    max_tilt: float = MAX_TILT_RAD,
) -> Hypotheses:
    """Returns the hypotheses of an image; `maps`: smoothed; `certainty`: length of GGCNN's (cos, sin), shape of the
    maps; `most_open`: what the hand opens at most [m]; `max_tilt`: as of `upright`."""
    rows, columns = places(maps, image, camera, frame).T
    rays = image_rays(image, camera)
    points = image.depth[rows, columns, None] * rays[rows, columns]
    scale = image.depth[rows, columns] * image.crop.side / len(image.depth) / camera.K[0, 0]
    table = np.array(turns)
    line = (maps.angle[rows, columns][:, None] + table[:, 0]).ravel()
    pitch, roll, wider, back = (np.tile(table[:, i], len(rows)) for i in range(1, 5))
    width = np.repeat(maps.width[rows, columns] * scale, len(turns))
    R = np.einsum("ij,njk->nik", frame.R, level_rotation(azimuth(line, frame), pitch, roll))
    T = np.tile(np.eye(4), (len(R), 1, 1))
    T[:, :3, :3] = upright(R, frame, max_tilt)
    T[:, :3, 3] = np.repeat(points, len(turns), axis=0) - back[:, None] * T[:, :3, 2]
    opening = np.clip(width + wider, MIN_OPENING_M, most_open)
    return Hypotheses(T, opening, said_of(T, opening, maps, certainty, image, camera))


def places(maps: Maps, image: NetworkImage, camera: CameraModel, frame: LevelFrame) -> np.ndarray:
    """Returns the pixels (row, column) where grasps are tried, shape (n, 2): the best ones of GGCNN's quality first,
    then those highest above the table."""
    height = heights(image, camera, frame)
    inner = np.zeros(maps.quality.shape, bool)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    rows, columns = np.nonzero(inner & image.valid & (height > OBJECT_M))
    order_by = maps.quality[rows, columns] + 1e-3 * np.clip(height[rows, columns], 0.0, 0.5)
    order = np.argsort(-order_by, kind="stable")
    free = np.ones(maps.quality.shape, bool)
    found: list[tuple[int, int]] = []
    for row, column in zip(rows[order].tolist(), columns[order].tolist()):
        if len(found) == PLACES:
            break
        if free[row, column]:
            found.append((row, column))
            free[
                max(0, row - SPACING_PX + 1) : row + SPACING_PX, max(0, column - SPACING_PX + 1) : column + SPACING_PX
            ] = False
    return np.array(found, int).reshape(-1, 2)


def azimuth(line: np.ndarray, frame: LevelFrame) -> np.ndarray:
    """Returns the angle about the level frame's z axis of lines in the image, anticlockwise from its horizontal."""
    along = np.stack([np.cos(line), -np.sin(line), np.zeros_like(line)], axis=-1) @ frame.R
    return np.arctan2(along[:, 1], along[:, 0])


def level_rotation(azimuth: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Returns orientations of hands in the level frame, shape (n, 3, 3): turned about the line through the fingers by
    `pitch`, that line raised by `roll` and turned about the vertical by `azimuth`."""
    ca, sa, cp, sp, cr, sr = (f(a) for a in (azimuth, pitch, roll) for f in (np.cos, np.sin))
    x = np.stack([ca * cr, sa * cr, -sr], axis=-1)
    y = np.stack([-sa * cp + ca * sr * sp, ca * cp + sa * sr * sp, cr * sp], axis=-1)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def said_of(
    T: np.ndarray,
    opening: np.ndarray,
    maps: Maps,
    certainty: np.ndarray,
    image: NetworkImage,
    camera: CameraModel,
) -> np.ndarray:
    """Returns what GGCNN's maps say of grasps in the camera's frame, as `Hypotheses.seen`."""
    rows, columns, scale = pixels_of(T[:, :3, 3], image, camera)
    line = np.arctan2(-T[:, 1, 0], T[:, 0, 0])
    agrees = certainty[rows, columns] * np.cos(2.0 * (line - maps.angle[rows, columns]))
    wider = opening - maps.width[rows, columns] * scale
    return np.stack([maps.quality[rows, columns], agrees, wider / 0.05], axis=-1).astype(np.float32)


def pixels_of(
    points: np.ndarray, image: NetworkImage, camera: CameraModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns rows and columns of the network's image where points in the camera's frame, shape (..., 3), are seen, the
    nearest one for those outside, and the size of a pixel there [m]."""
    side = len(image.depth)
    seen = points @ pixel_matrix(image, camera).T
    z = np.maximum(seen[..., 2], 1e-3)
    column, row = (np.clip((seen[..., i] / z).astype(np.int32), 0, side - 1) for i in range(2))
    return row, column, z * image.crop.side / side / camera.K[0, 0]


def pixel_matrix(image: NetworkImage, camera: CameraModel) -> np.ndarray:
    """Returns what makes a point in the camera's frame its column and row in the network's image, both times its depth,
    and its depth, shape (3, 3); the fraction of a pixel counts from its edge."""
    scale = len(image.depth) / image.crop.side
    shift = np.array([image.crop.column - 0.5, image.crop.row - 0.5])
    K = np.array(camera.K, dtype=float)
    K[:2, 2] -= shift
    K[:2] *= scale
    return K


def varied(
    of: Hypotheses,
    each: int,
    rng: np.random.Generator,
    most_open: float,
    frame: LevelFrame,
    max_tilt: float = MAX_TILT_RAD,
    scale: float = 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns poses and openings near those of hypotheses, `each` of them for each one, in the hypotheses' order;
    `max_tilt`: as of `upright`; `scale`: of the poses' deviations."""
    T = np.repeat(of.T, each, axis=0)
    shape = (len(T), 3)
    turned = T[:, :3, :3] @ rotations(scale * rng.normal(0.0, (0.15, 0.15, 0.2), shape))
    T[:, :3, :3] = upright(turned, frame, max_tilt)
    T[:, :3, 3] += np.einsum("nij,nj->ni", T[:, :3, :3], scale * rng.normal(0.0, (0.004, 0.006, 0.006), shape))
    opening = np.clip(np.repeat(of.opening, each) + rng.normal(0.0, 0.008, len(T)), MIN_OPENING_M, most_open)
    return T, opening


def upright(R: np.ndarray, frame: LevelFrame, max_tilt: float) -> np.ndarray:
    """Returns orientations of hands before the camera, shape (n, 3, 3), turned as little as it takes until no approach
    is further than `max_tilt` [rad] from straight down."""
    down, approach = frame.R[:, 2], R[:, :, 2]
    tilt = np.arccos(np.clip(approach @ down, -1.0, 1.0))
    axis = np.cross(approach, down)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
    return rotations(axis * np.clip(tilt - max_tilt, 0.0, None)[:, None]) @ R


def turned(R: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns by how much grasps are turned against others [rad], shape (...) of orientations, shape (..., 3, 3); half
    a turn about the approach, which exchanges the fingers, counts as 0."""
    same = np.einsum("...ji,...ji->...i", R, other)
    return np.arccos(np.clip(0.5 * (np.abs(same[..., 0] + same[..., 1]) + same[..., 2] - 1.0), -1.0, 1.0))


def rotations(turn: np.ndarray) -> np.ndarray:
    """Returns the rotations of rotation vectors, shape (n, 3) to (n, 3, 3) [rad]."""
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    axis = turn / np.maximum(angle, 1e-12)
    K = np.zeros((len(turn), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    K -= K.transpose(0, 2, 1)
    s, c = np.sin(angle)[..., None], np.cos(angle)[..., None]
    return np.eye(3) + s * K + (1.0 - c) * (K @ K)

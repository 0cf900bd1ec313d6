"""What a policy sees and says, alike where it is trained and where it runs, all from the tool's level frame: its origin
is the tool point, z points up, x is the heading of the tool's x axis. So an object is as far from the hand as the
calibrated depth camera sees it, wherever both are, and few episodes show much."""

from __future__ import annotations

import math

import numpy as np

from common.camera_model import CameraModel
from common.poses import pose
from common.rotations import rotation_about

CELLS, CELL_M = 52, 0.01  # of the map, to each side
ABOVE_M, BELOW_M = 0.02, 0.4  # of the tool point: what the map shows; a cell without a point is at the bottom
NOTHING_M = 0.001 - BELOW_M  # what is not above this is nothing
STRIDE = 2  # of the pixels that are looked at
NEAR_M, FAR_M = 0.3, 2.0  # of depths that count
FINGERS, TOUCH = 4, 3  # motors, and fingers that feel
STATE = 7 + FINGERS + TOUCH
ACTION = 9 + FINGERS


class DepthView:
    """Where the pixels of a depth camera look."""

    def __init__(self, camera: CameraModel) -> None:
        rows, columns = np.mgrid[0 : camera.height : STRIDE, 0 : camera.width : STRIDE]
        self.camera = camera
        self._rays = camera.rays(np.stack([columns, rows], axis=-1))

    def points(self, depth: np.ndarray, T_base_camera: np.ndarray) -> np.ndarray:
        """Returns the points of an image, shape (h, w) [m], in the base, shape (n, 3); `T_base_camera`: of its optical
        frame, shape (4, 4). Raises ValueError for an image of another size."""
        seen = depth[::STRIDE, ::STRIDE]
        if seen.shape != self._rays.shape[:2]:
            raise ValueError(f"the depth image is {depth.shape[1]} x {depth.shape[0]} px, unlike its camera_info")
        with np.errstate(invalid="ignore"):
            good = (seen > NEAR_M) & (seen < FAR_M)
        points = self._rays[good] * seen[good][:, None]
        return points @ T_base_camera[:3, :3].T + T_base_camera[:3, 3]


def level_frame(T_base_tool: np.ndarray) -> np.ndarray:
    """Returns the tool's level frame in the base, shape (4, 4)."""
    return pose(rotation_about(2, math.atan2(T_base_tool[1, 0], T_base_tool[0, 0])), T_base_tool[:3, 3])


def height_map(points: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray:
    """Returns the highest point of each cell around the tool, shape (52, 52) [m], x by rows, in its level frame;
    `points` in the base, shape (n, 3)."""
    level = level_frame(T_base_tool)
    x, y, z = ((points - level[:3, 3]) @ level[:3, :3]).T
    row, column = (np.floor(part / CELL_M).astype(int) + CELLS // 2 for part in (x, y))
    shown = (row >= 0) & (row < CELLS) & (column >= 0) & (column < CELLS) & (z < ABOVE_M)
    heights = np.full((CELLS, CELLS), -BELOW_M)
    np.maximum.at(heights, (row[shown], column[shown]), z[shown])
    return heights.astype(np.float32)


def state_numbers(T_base_tool: np.ndarray, fingers: np.ndarray, contacts: np.ndarray) -> np.ndarray:
    """Returns the state, shape (14,): height [m], orientation in the level frame, the motors' angles [rad], and how
    much of each finger is touched, of its taxels' contacts."""
    R = level_frame(T_base_tool)[:3, :3].T @ T_base_tool[:3, :3]
    touched = np.reshape(contacts, (TOUCH, -1)).mean(axis=1)
    return np.concatenate([T_base_tool[2:3, 3], R[:, 0], R[:, 1], fingers, touched]).astype(np.float32)


def action_numbers(T_base_tool: np.ndarray, T_base_desired: np.ndarray, fingers: np.ndarray) -> np.ndarray:
    """Returns an action seen from the tool, shape (13,): position [m], orientation, and the motors' commands [rad]."""
    level = level_frame(T_base_tool)
    R = level[:3, :3].T @ T_base_desired[:3, :3]
    p = level[:3, :3].T @ (T_base_desired[:3, 3] - level[:3, 3])
    return np.concatenate([p, R[:, 0], R[:, 1], fingers]).astype(np.float32)


def desired_tool(T_base_tool: np.ndarray, action: np.ndarray) -> np.ndarray:
    """Returns the desired tool in the base, shape (4, 4), that an action means, as a network says it: its two axes need
    not be unit vectors at right angles. Raises ValueError if they give no orientation."""
    x, y = action[3:6], action[6:9]
    z = np.cross(x, y)
    if not (np.isfinite(action).all() and np.linalg.norm(z) > 0.1):
        raise ValueError("the policy's numbers are no orientation")
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    return level_frame(T_base_tool) @ pose(np.column_stack([x, np.cross(z, x), z]), action[:3])

"""Views of a marker board on an arm with known truth, for the tests of the calibration."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from common.poses import inverse, pose
from vision.calibration.hand_eye import CalibrationView

SD = np.array([4e-4, 4e-4, 2e-3, 3e-3, 3e-3, 1e-3])
"""Standard deviations of a board detection: largest along the line of sight, and about the axes across it [m, rad]."""


def random_pose(rng, reach):
    return pose(pin.exp3(rng.uniform(-np.pi, np.pi) * direction(rng)), rng.uniform(-reach, reach, 3))


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def change(T, x):
    return pose(pin.exp3(x[3:]) @ T[:3, :3], T[:3, 3] + x[:3])


def difference(T, truth):
    return np.concatenate((T[:3, 3] - truth[:3, 3], pin.log3(T[:3, :3] @ truth[:3, :3].T)))


def scene(seed, count=12, noise=None, turn=0.6):
    """A true T_flange_board and T_base_camera, and views with noise whose standard deviations are `noise`."""
    rng = np.random.default_rng(seed)
    X, Z = random_pose(rng, 0.1), random_pose(rng, 1.0)
    middle = random_pose(rng, 0.1)
    views = []
    for _ in range(count):
        T_camera_board = pose(
            pin.exp3(rng.uniform(-turn, turn, 3)), rng.uniform((-0.15, -0.15, 0.85), (0.15, 0.15, 1.15))
        )
        T_camera_board = T_camera_board @ middle
        B = Z @ T_camera_board @ inverse(X)
        if noise is not None:
            T_camera_board = change(T_camera_board, rng.normal(0.0, noise))
        views.append(CalibrationView(B, T_camera_board, np.diag((SD if noise is None else noise) ** 2)))
    return X, Z, views

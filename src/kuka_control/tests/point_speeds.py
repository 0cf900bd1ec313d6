"""Speeds of the points of the moving arm, by differences along joints; for tests of the speed limits."""

from __future__ import annotations

import numpy as np

from common.rotations import rotation_angle
from iiwa_kinematics import arm_points, forward


def point_speeds(model, times, joints, carried):
    """Returns the speeds of elbow, wrist, flange and the balls that it carries, shape (n - 1, 3 + balls) [m/s].

    `joints` at the `times`, shapes (n, 7) and (n,).
    """
    T = np.array([forward(model, q) for q in joints])
    arm = np.array([arm_points(model, q)[2:] for q in joints])
    balls = np.array(carried)
    centres = np.einsum("nij,kj->nki", T[:, :3, :3], balls[:, :3]) + T[:, None, :3, 3]
    steps = np.linalg.norm(np.diff(np.concatenate([arm, centres], axis=1), axis=0), axis=2)
    turns = [rotation_angle(a.T @ b) for a, b in zip(T[:-1, :3, :3], T[1:, :3, :3])]
    steps[:, 3:] += np.outer(turns, balls[:, 3])
    return steps / np.diff(times)[:, None]

"""Where each link of the arm is, for pictures: the controller's own kinematics need no more than the flange.

The frames stand where joint axes cross: link 1 in the base, 2 and 3 in the shoulder, 4 and 5 in the elbow, 6 and 7 in
the wrist.
"""

from __future__ import annotations

import numpy as np

from common.poses import pose, translation
from common.rotations import rotation_about
from kuka_control.robot_model import RobotModel

Y, Z = 1, 2
AXES = ((Z, 1.0), (Y, 1.0), (Z, 1.0), (Y, -1.0), (Z, 1.0), (Y, 1.0), (Z, 1.0))
"""Axis that each joint turns about, in the frame of the link before it, and the sign of the turn."""


def link_frames(model: RobotModel, q: np.ndarray) -> np.ndarray:
    """Returns the poses of links 1 to 7 and of the flange in the base, shape (8, 4, 4) [m].

    Args:
        model: the arm.
        q: joint angles, shape (7,) [rad].
    """
    before = (0.0, model.base_shoulder, 0.0, model.shoulder_elbow, 0.0, model.elbow_wrist, 0.0)
    T = np.eye(4)
    frames = []
    for (axis, sign), length, angle in zip(AXES, before, q):
        T = T @ translation(0.0, 0.0, length) @ pose(rotation_about(axis, sign * angle))
        frames.append(T)
    frames.append(T @ translation(0.0, 0.0, model.wrist_flange))
    return np.array(frames)

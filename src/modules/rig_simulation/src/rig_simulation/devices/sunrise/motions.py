"""The server's stored goals in its own units, and the motions that its main thread plans from them. Each planner
returns the motion from the present position of the arm, or None if the arm is at its target already."""

from __future__ import annotations

import dataclasses
from typing import Callable

import numpy as np

from common.poses import pose
from common.rotations import rotation_from_zyx, zyx_from_rotation
from rig_simulation.devices.sunrise import java_text
from rig_simulation.devices.sunrise.arm import SimulatedArm
from rig_simulation.devices.sunrise.paths import JointMove, Unreachable

MM_PER_M = 1000.0
DEFAULT_RELATIVE_SPEED = 0.1


@dataclasses.dataclass
class Goals:
    """The server's stored goals."""

    # Of `jp_` and similar commands, shape (7,) [rad]; target of joint motions, goal of the joint servo
    joints: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(7))
    speed: float = DEFAULT_RELATIVE_SPEED  # relative speed of joint motions


def overwritten(values: np.ndarray, words: list[str]) -> np.ndarray:
    """Returns the values with the first ones replaced by the words' numbers; raises ValueError for other words."""
    result = values.copy()
    for k, word in enumerate(words[: len(values)]):
        result[k] = java_text.number(word)
    return result


def finite(words: list[str]) -> np.ndarray:
    """Returns the numbers of the words, shape (n,); raises ValueError unless all are finite."""
    numbers = np.array([java_text.number(word) for word in words])
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"{words} are not all finite numbers")
    return numbers


def pose_from_frame(frame: np.ndarray) -> np.ndarray:
    """Returns the pose, shape (4, 4) [m], of X, Y, Z [mm], A, B, C [rad], shape (6,)."""
    return pose(rotation_from_zyx(*frame[3:]), frame[:3] / MM_PER_M)


def frame_from_pose(T: np.ndarray) -> np.ndarray:
    """Returns X, Y, Z [mm], A, B, C [rad], shape (6,), of a pose, shape (4, 4) [m]."""
    return np.array([*(MM_PER_M * T[:3, 3]), *zyx_from_rotation(T[:3, :3])])


ARRIVED_JOINT_RAD = np.radians(0.1)


def joint_motion(arm: SimulatedArm, goals: Goals) -> JointMove | None:
    if not 0.0 < goals.speed <= 1.0 or not arm.robot.within_range(goals.joints):
        raise Unreachable(f"the speed {goals.speed} or the goal {goals.joints.tolist()} is out of range")
    if np.array_equal(arm.q, goals.joints):
        return None
    return JointMove(arm.q, goals.joints, goals.speed * arm.robot.max_speed, arm.motion_acceleration)


def leaves_torque_ranges(ranges: np.ndarray) -> Callable[[SimulatedArm], str]:
    """Returns the condition that interrupts a guarded motion: it names the joint. `ranges`: rows of joint index 0 to 6,
    lowest, highest external torque, shape (n, 3) [Nm]."""
    joints, low, high = ranges[:, 0].astype(int), ranges[:, 1], ranges[:, 2]

    def condition(arm: SimulatedArm) -> str:
        torque = arm.external_torques[joints]
        left = (torque < low) | (torque > high)
        return f"joint {joints[left.argmax()] + 1}" if left.any() else ""

    return condition


def arrived_at_joints(arm: SimulatedArm, q: np.ndarray) -> bool:
    """Returns whether a guarded joint motion has arrived at the angles q, shape (7,) [rad]."""
    return bool(np.max(np.abs(arm.q - q)) <= ARRIVED_JOINT_RAD)

"""The goals that the server stores for later motions and servo modes, in its own units."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from common.poses import pose
from common.rotations import rotation_from_zyx, zyx_from_rotation
from rig_simulation.devices.sunrise import java_text
from rig_simulation.devices.sunrise.paths import Unreachable

MM_PER_M = 1000.0
DEFAULT_RELATIVE_SPEED = 0.1


def _zeros(size: int) -> Any:
    return dataclasses.field(default_factory=lambda: np.zeros(size))


@dataclasses.dataclass
class Goals:
    """The server's stored goals."""

    # Of `jp_` and similar commands, shape (7,) [rad]; target of joint motions, goal of the joint servo
    joints: np.ndarray = _zeros(7)
    speeds: np.ndarray = _zeros(7)  # of the velocity servo, shape (7,) [rad/s]
    # Poses X, Y, Z [mm], A, B, C [rad], shape (6,)
    target: np.ndarray = _zeros(6)  # of lines
    via: np.ndarray = _zeros(6)  # of circles
    end: np.ndarray = _zeros(6)  # of circles
    servo: np.ndarray = _zeros(6)  # of the Cartesian servo
    speed: float = DEFAULT_RELATIVE_SPEED  # relative speed of joint motions, or mm/s of the tool


def overwritten(values: np.ndarray, words: list[str]) -> np.ndarray:
    """Returns the values with the first ones replaced by the numbers of the words; ignores further words.

    Raises:
        ValueError: a word is not a number.
    """
    result = values.copy()
    for k, word in enumerate(words[: len(values)]):
        result[k] = java_text.number(word)
    return result


def finite(words: list[str]) -> np.ndarray:
    """Returns the numbers of the words, shape (n,).

    Raises:
        ValueError: a word is not a finite number.
    """
    numbers = np.array([java_text.number(word) for word in words])
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"{words} are not all finite numbers")
    return numbers


def pose_from_frame(frame: np.ndarray) -> np.ndarray:
    """Returns the pose, shape (4, 4) [m], of X, Y, Z [mm], A, B, C [rad], shape (6,).

    Raises:
        Unreachable: a number is not finite.
    """
    if not np.all(np.isfinite(frame)):
        raise Unreachable(f"the pose {frame.tolist()} is not finite")
    return pose(rotation_from_zyx(*frame[3:]), frame[:3] / MM_PER_M)


def frame_from_pose(T: np.ndarray) -> np.ndarray:
    """Returns X, Y, Z [mm], A, B, C [rad], shape (6,), of a pose, shape (4, 4) [m]."""
    return np.array([*(MM_PER_M * T[:3, 3]), *zyx_from_rotation(T[:3, :3])])

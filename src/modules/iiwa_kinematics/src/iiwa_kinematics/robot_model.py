"""The arms: lengths, joint ranges and joint speeds of the KUKA LBR iiwa, with the media flange that is mounted on it.
Metres along the outstretched arm, radians. The flange frame lies in the centre of the media flange's outer face, z
outwards. Sources: KUKA's data sheets of the LBR iiwa 7 R800 and 14 R820 and of its media flanges; the lengths are also
those of the KUKA Sunrise Toolbox (table of Denavit-Hartenberg parameters, flange heights)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

FLANGE_HEIGHTS = {
    "MF_elektrisch": 0.035,
    "MF_pneumatisch": 0.035,
    "MF_IO_pneumatisch": 0.035,
    "MF_touch_pneumatisch": 0.061,
}
"""Height of each media flange, from link 7 to the outer face [m]."""

WRIST_LINK_7 = 0.126  # from the wrist, where the axes of joints 5, 6 and 7 meet, to the face of link 7 [m]
JOINT_RANGES_DEG = (170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0)  # either way [deg], in both arms

# Lengths base - shoulder, shoulder - elbow, elbow - wrist [m]; joint speeds [deg/s].
_ARMS = {
    "LBR7R800": ((0.340, 0.400, 0.400), (98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0)),
    "LBR14R820": ((0.360, 0.420, 0.400), (85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0)),
}

ROBOTS = tuple(_ARMS)


@dataclass(frozen=True, eq=False)
class RobotModel:
    """An arm with its media flange."""

    name: str  # the arm, as in the parameter kuka/robot
    flange: str  # the media flange, as in the parameter kuka/flange
    base_shoulder: float  # height of the origin of joint 2 above the base [m]
    shoulder_elbow: float  # length of the upper arm [m]
    elbow_wrist: float  # length of the forearm [m]
    wrist_flange: float  # from the wrist to the outer face of the media flange [m]
    lower: np.ndarray  # least joint angles, shape (7,) [rad]
    upper: np.ndarray  # greatest joint angles, shape (7,) [rad]
    max_speed: np.ndarray  # greatest joint speeds, shape (7,) [rad/s]


def read_only(values: ArrayLike) -> np.ndarray:
    """Returns a float copy of `values` that cannot be written to, for frozen records."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def robot_model(robot: str, flange: str) -> RobotModel:
    """Returns the arm `robot` with the media flange `flange`. Raises ValueError: no such arm or no such flange."""
    if robot not in _ARMS:
        raise ValueError(f"there is no robot {robot!r}; choose one of {', '.join(_ARMS)}")
    if flange not in FLANGE_HEIGHTS:
        raise ValueError(f"there is no media flange {flange!r}; choose one of {', '.join(FLANGE_HEIGHTS)}")
    lengths, speeds = _ARMS[robot]
    upper = read_only(np.radians(JOINT_RANGES_DEG))
    wrist_flange = WRIST_LINK_7 + FLANGE_HEIGHTS[flange]
    return RobotModel(robot, flange, *lengths, wrist_flange, read_only(-upper), upper, read_only(np.radians(speeds)))

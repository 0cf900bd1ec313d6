"""The robot hand in names, and what its state topic says: a rig with another hand changes this file first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class HandDescription:
    """A hand of fingers that each have a motor, and one motor that spreads them."""

    driver: str  # namespace of its topics and services
    fingers: tuple[str, ...]  # in the order of its messages; the last one is the thumb
    spread: str  # what the motor after them moves
    links: tuple[str, ...]  # of a finger in the robot model, from the palm on; the finger's number follows, from 1
    calibrations: tuple[str, ...]  # services

    @property
    def motors(self) -> tuple[str, ...]:
        """Names of all motors: the order of angles, of commands and of stored columns."""
        return (*self.fingers, self.spread)

    @property
    def state(self) -> str:
        return f"{self.driver}/hand_state"

    @property
    def commands(self) -> tuple[str, ...]:
        return f"{self.driver}/radian_hand_command", f"{self.driver}/raw_hand_command"

    def bodies(self, finger: int) -> tuple[str, ...]:
        """Returns the names of a finger's links in the robot model; `finger` counts from 1."""
        return tuple(f"{link}_{finger}" for link in self.links)


HAND = HandDescription(
    driver="reflex_takktile",
    fingers=("index", "middle", "thumb"),
    spread="spread",
    links=("proximal", "distal"),
    calibrations=("reflex_takktile/calibrate_fingers", "reflex_takktile/calibrate_tactile"),
)
"""The ReFlex TakkTile of this rig."""


@dataclass(frozen=True, eq=False)
class HandState:
    """A message of reflex_msgs/Hand as arrays; fingers in the order of HAND."""

    angles: np.ndarray  # of the motors, shape (4,) [rad], 0 is open
    loads: np.ndarray  # of the motors, shape (4,)
    proximal: np.ndarray  # joints of the fingers, shape (3,) [rad]
    distal: np.ndarray  # joints of the fingers, shape (3,) [rad]
    pressures: np.ndarray  # of the taxels, shape (3, taxels) [counts]
    contacts: np.ndarray  # whether each taxel is touched, shape (3, taxels), bool


def hand_state(message: Any) -> HandState:
    motors, fingers = message.motor, message.finger
    return HandState(
        np.array([motor.joint_angle for motor in motors]),
        np.array([motor.load for motor in motors]),
        np.array([finger.proximal for finger in fingers]),
        np.array([finger.distal_approx for finger in fingers]),
        np.array([finger.pressure for finger in fingers]),
        np.array([finger.contact for finger in fingers], dtype=bool),
    )

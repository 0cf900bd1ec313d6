"""Configuration: the mapping from the human to the robot hand, and the force limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import choice, flag, number, text, vector
from common.hand_tracking import ANY, LEFT, RIGHT
from common.robot_hand import HAND
from common.simulated import simulated_field

FINGERS = HAND.motors
"""Order of the angles of the human hand and of the commands of the robot hand."""
STEERING = "steering"


@dataclass(frozen=True)
class NodeConfig:
    """The private parameters of the node."""

    hand_only: bool = flag(doc="run without waiting for kuka/gripper_control", absent=True)
    hand: str = choice(
        *(LEFT, RIGHT, ANY), doc="which hand of the operator the robot hand follows, as the arm's leap/hand", absent=ANY
    )
    operator: str = text(doc="name of the person whose hand was measured, for the log", absent="", empty=True)
    service_timeout: float = number(
        "s", above=0.0, doc="how long to wait for the services of the hand's driver", absent=60.0
    )


@dataclass(frozen=True)
class HandConfig:
    """The parameters under `leap_hand/`: per finger [open, closed], of the human and of the robot hand; force limit."""

    index_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="palm normal to index tip")
    index_robot: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="command to the index finger")
    middle_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="palm normal to middle tip")
    middle_robot: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="command to the middle finger")
    thumb_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="palm normal to thumb tip")
    thumb_robot: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="command to the thumb")
    spread_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="index bone to middle bone")
    spread_robot: np.ndarray = vector(2, "deg", low=0.0, high=90.0, doc="command to the spread")
    force_limit: bool = flag(doc="stop fingers that press", absent=True)
    force_limit_pressure: float = number(
        "counts", above=0.0, high=200.0, doc="of a taxel; above it the finger stops", absent=60.0
    )
    force_limit_load: float = number(
        "0.1 % of the largest torque", above=0.0, high=1000.0, doc="above it the finger stops", absent=230.0
    )
    force_limit_release: float = number(
        above=0.0, below=1.0, doc="fraction of both limits below which the finger may close again", absent=0.5
    )
    force_limit_silence: float = number(
        "s", low=0.1, high=5.0, doc="without a state of the hand for this long no finger closes", absent=0.5
    )

    grip_hold: float = number(
        "s", low=0.0, high=10.0, doc="how long the grip is kept after the operator's hand is lost", absent=0.2
    )
    fingers_follow: str = choice(
        *(ANY, STEERING),
        doc="who moves the fingers while no hand steers the arm: any hand in view, as in 2019, or none",
        absent=ANY,
    )
    simulated: bool | None = simulated_field()

    @property
    def human(self) -> np.ndarray:
        """Angles of the open and of the closed human hand, shape (4, 2) [rad]."""
        return np.radians([getattr(self, f"{finger}_human") for finger in FINGERS])

    @property
    def robot(self) -> np.ndarray:
        """Angles of the open and of the closed robot hand, shape (4, 2) [rad]."""
        return np.radians([getattr(self, f"{finger}_robot") for finger in FINGERS])

    def faults(self) -> list[str]:
        return [
            f"{finger}_human is {getattr(self, f'{finger}_human').tolist()} deg, "
            "but open and closed must differ by 1 deg at least."
            for finger in FINGERS
            if abs(np.diff(getattr(self, f"{finger}_human"))[0]) < 1.0
        ]

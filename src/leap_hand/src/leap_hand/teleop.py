"""From tracking frames to commands of the robot hand: choice of the hand, flexion, mapping, and when to open.

No hand, a hand without five fingers, or the gripper's control switched off: the open pose. A frame with bad numbers is
left out, so that the hand does not let go for one torn frame. When no usable frame came for half a second the hand is
opened, once, as it would be without a hand in view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.frame_watch import FrameWatch
from common.hand_choice import HandChoice
from common.poses import read_only
from leap_hand.config import HandConfig
from leap_hand.flexion import HandPoints, flexion
from leap_hand.mapping import map_angles

WAITING = "waiting"
FOLLOWING = "following"
OPEN = "open"
GRIPPER_OFF = "the control of the gripper is off"

MAX_SILENCE_S = 0.5
MAX_BAD_FRAMES = 5
"""After so many frames with bad numbers in a row the hand is opened."""


@dataclass(frozen=True)
class TrackedHand:
    """One hand of one tracking frame.

    Attributes:
        id: the tracker's number of this hand.
        is_left: whether it is a left hand.
        points: where its joints are, or None unless it has five fingers.
    """

    id: int
    is_left: bool
    points: HandPoints | None


@dataclass(frozen=True)
class TrackingFrame:
    """One frame of the tracker.

    Attributes:
        id: the tracker's number of the frame.
        age: time of arrival less the frame's stamp [s].
        hands: the hands in view.
    """

    id: int
    age: float
    hands: tuple[TrackedHand, ...]


@dataclass(frozen=True)
class HandResult:
    """What became of a frame.

    Attributes:
        state: FOLLOWING a hand, OPEN, or WAITING for the gripper's control.
        reason: one sentence.
        command: angles of index, middle, thumb, spread, shape (4,) [rad], or None where nothing is to be sent.
    """

    state: str
    reason: str
    command: np.ndarray | None


class Teleop:
    """The chain of steps with its state.

    Args:
        config: limits of the human and the robot hand.
        hand_only: start without being told that the gripper's control is on.

    Attributes:
        open_pose: angles of the open robot hand, shape (4,) [rad].
    """

    def __init__(self, config: HandConfig, hand_only: bool) -> None:
        self._human, self._robot = config.human, config.robot
        self.open_pose = read_only(self._robot[:, 0])
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._choice = HandChoice()
        self._gripper_on: bool | None = True if hand_only else None
        self._opened_in_silence = False
        self._bad_frames = 0

    def switch(self, gripper_on: bool) -> HandResult | None:
        """Takes the gripper's flag in; returns the open pose if that switches the control off, else None."""
        changed = gripper_on != self._gripper_on
        self._gripper_on = gripper_on
        return self._open(GRIPPER_OFF) if changed and not gripper_on else None

    def step(self, frame: TrackingFrame, now: float) -> HandResult | None:
        """Takes a frame in; returns what it asks for, or None if it is a repeated frame or not one of the present.

        Args:
            frame: the newest frame.
            now: time of its arrival, on a clock that never jumps [s].
        """
        arrival = self._watch.arrived(frame.id, frame.age, now)
        if not arrival.usable:
            return None
        self._opened_in_silence = False
        hand = self._choice.choose(frame.hands)
        if self._gripper_on is None:
            return HandResult(WAITING, "waiting for kuka/gripper_control", None)
        if not self._gripper_on:
            return self._open(GRIPPER_OFF)
        if hand is None:
            return self._open("no hand is seen")
        if hand.points is None:
            return self._open(f"{_name(hand)} has not five fingers")
        return self._follow(hand, hand.points)

    def silence(self, now: float) -> HandResult | None:
        """Returns the open pose, once, when no usable frame came for MAX_SILENCE_S, else None."""
        silence = self._watch.silence(now)
        if silence is None or self._opened_in_silence or self._gripper_on is None:
            return None
        self._opened_in_silence = True
        return self._open(silence)

    def _follow(self, hand: TrackedHand, points: HandPoints) -> HandResult:
        try:
            angles = flexion(points)
        except ValueError as error:
            self._bad_frames += 1
            if self._bad_frames >= MAX_BAD_FRAMES:
                return self._open(f"{_name(hand)} has bad numbers: {error}")
            return HandResult(FOLLOWING, f"one frame of {_name(hand)} was left out: {error}", None)
        self._bad_frames = 0
        command = map_angles(angles, self._human, self._robot)
        return HandResult(FOLLOWING, f"{_name(hand)} is followed", read_only(command))

    def _open(self, reason: str) -> HandResult:
        return HandResult(OPEN, reason, self.open_pose)


def _name(hand: TrackedHand) -> str:
    return f"{'left' if hand.is_left else 'right'} hand {hand.id}"

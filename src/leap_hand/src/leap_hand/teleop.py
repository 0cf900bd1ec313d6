"""From tracking frames to commands of the robot hand: choice of the hand, flexion, mapping, and when to open.

The hand opens when no hand is in view, when the hand in view lacks a finger, and when control of the gripper is off.
A frame with invalid numbers is skipped, so that one bad frame does not drop the object. After MAX_SILENCE_S without a
usable frame the hand opens once, as it would without a hand in view.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from common.hand_tracking import FrameWatch, HandChoice
from common.poses import read_only
from leap_hand.config import HandConfig
from leap_hand.flexion import flexion, map_angles
from leap_motion.frames import FingerPoints, TrackedHand, TrackingFrame

GRIPPER_OFF = "the control of the gripper is off"

MAX_SILENCE_S = 0.5
MAX_BAD_FRAMES = 5  # the hand opens after this many frames with invalid numbers in a row


class GripperState(Enum):
    """What the robot hand does."""

    WAITING = "waiting"  # for the first message on kuka/gripper_control
    FOLLOWING = "following"  # the operator's hand
    OPEN = "open"


@dataclass(frozen=True)
class GripperResult:
    """The result of a frame."""

    state: GripperState
    reason: str  # one sentence
    command: np.ndarray | None  # angles of index, middle, thumb, spread, shape (4,) [rad]; None: send nothing


class HandTeleop:
    """The chain of steps with its state; `open_pose` has the angles of the open robot hand, shape (4,) [rad].

    With `hand_only` it starts without a message on kuka/gripper_control.
    """

    def __init__(self, config: HandConfig, hand_only: bool) -> None:
        self._human, self._robot = config.human, config.robot
        self.open_pose = read_only(self._robot[:, 0])
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._choice = HandChoice()
        self._gripper_on: bool | None = True if hand_only else None
        self._opened_in_silence = False
        self._bad_frames = 0

    def switch(self, gripper_on: bool) -> GripperResult | None:
        """Sets control of the gripper; returns the open pose if this switches it off, else None."""
        changed = gripper_on != self._gripper_on
        self._gripper_on = gripper_on
        return self._open(GRIPPER_OFF) if changed and not gripper_on else None

    def step(self, frame: TrackingFrame, now: float) -> GripperResult | None:
        """Processes a frame that arrived at `now` on a monotonic clock [s].

        Returns None for a repeated frame and for one with an old or future stamp.
        """
        if not self._watch.arrived(frame.id, frame.age, now).usable:
            return None
        self._opened_in_silence = False
        hand = self._choice.choose(frame.hands)
        if self._gripper_on is None:
            return GripperResult(GripperState.WAITING, "waiting for kuka/gripper_control", None)
        if not self._gripper_on:
            return self._open(GRIPPER_OFF)
        if hand is None:
            return self._open("no hand is seen")
        if hand.fingers is None:
            return self._open(f"{hand.name} has not five fingers")
        return self._follow(hand, hand.fingers)

    def silence(self, now: float) -> GripperResult | None:
        """Returns the open pose, once, when no usable frame came for MAX_SILENCE_S, else None."""
        silence = self._watch.silence(now)
        if silence is None or self._opened_in_silence or self._gripper_on is None:
            return None
        self._opened_in_silence = True
        return self._open(silence)

    def _follow(self, hand: TrackedHand, fingers: FingerPoints) -> GripperResult:
        try:
            angles = flexion(hand.palm, hand.normal, fingers)
        except ValueError as error:
            self._bad_frames += 1
            if self._bad_frames >= MAX_BAD_FRAMES:
                return self._open(f"{hand.name} has invalid numbers: {error}")
            return GripperResult(GripperState.FOLLOWING, f"one frame of {hand.name} was skipped: {error}", None)
        self._bad_frames = 0
        command = map_angles(angles, self._human, self._robot)
        return GripperResult(GripperState.FOLLOWING, f"{hand.name} is followed", read_only(command))

    def _open(self, reason: str) -> GripperResult:
        return GripperResult(GripperState.OPEN, reason, self.open_pose)

"""From tracking frames to commands of the robot hand: whom it follows, flexion, mapping, and when to open.

Arm and robot hand have one owner: the hand that leap_kuka has locked, by id and side (`steered_by`), as long as it goes
on reporting that. Where no leap_kuka ever reported, the lock is made here, by the same rules without a box
(common.hand_tracking.HandLock).

The hand opens when gripper control is off. It opens when its owner is missing, lacks a finger or has invalid numbers,
or nobody is the owner: but only `grip_hold` after the last good frame, by default as long as the arm waits
for its hand, or as long as leap_kuka says so: while it keeps the tool for the next relative engagement, a held object
must not fall. At the next engagement each finger then keeps its command until the operator's finger comes near it.
Another hand in view changes nothing. Without a usable frame it opens once, after MAX_SILENCE_S.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from common.hand_tracking import ANY, FrameWatch, HandLock, of_side
from common.poses import read_only
from leap_hand.config import FINGERS, HandConfig
from leap_hand.flexion import flexion, map_angles
from leap_motion.frames import TrackedHand, TrackingFrame

GRIPPER_OFF = "the control of the gripper is off"

MAX_SILENCE_S = 0.5
MAX_UNREPORTED_S = 1.5  # leap_kuka reports twice a second; after so long without it nobody is the owner
NEAR = 0.15  # of a finger's range: so near to the kept command the operator's finger takes over
MAX_MISSING_S = 0.2  # longest time without the owner of a lock that is made here


class GripperState(Enum):
    """What the robot hand does."""

    WAITING = "waiting"  # for the first message on kuka/gripper_control
    FOLLOWING = "following"  # the operator's hand
    KEEPING = "keeping"  # its grip, without the operator's hand
    OPEN = "open"


@dataclass(frozen=True)
class GripperResult:
    """The result of a frame."""

    state: GripperState
    reason: str  # one sentence
    command: np.ndarray | None  # angles of index, middle, thumb, spread, shape (4,) [rad]; None: send nothing


@dataclass
class GripperCounts:
    """Events since the start."""

    grips_kept: int = 0  # times that the hand went missing and the grip was kept
    grips_opened: int = 0  # of them, times that it stayed missing and the hand opened


class HandTeleop:
    """The chain of steps with its state; `open_pose` has the angles of the open robot hand, shape (4,) [rad].

    With `hand_only` it starts without a message on kuka/gripper_control, and makes the lock itself. Hands of another
    side than `side` (LEFT, RIGHT or ANY of common.hand_tracking) do not exist for it.
    """

    def __init__(self, config: HandConfig, hand_only: bool, side: str = ANY) -> None:
        self._side, self._nobody = side, "no hand is seen" if side == ANY else f"no {side} hand is seen"
        self._human, self._robot, self._grip_hold = config.human, config.robot, config.grip_hold
        self.open_pose = read_only(self._robot[:, 0])
        self.counts = GripperCounts()
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._lock: HandLock[TrackedHand] = HandLock(max(MAX_MISSING_S, config.grip_hold))
        self._hand_only = hand_only
        self._arm_reports, self._reported_at = False, -math.inf
        self._owner: tuple[int, bool] | None = None
        self._keep_grip = False
        self._gripper_on: bool | None = True if hand_only else None
        self._opened_in_silence = False
        self._state = GripperState.WAITING
        self._followed_at = -math.inf
        self._command = self.open_pose  # that was sent last
        self._kept = np.zeros(len(self._robot), dtype=bool)  # fingers that keep it until the operator's come near

    def steered_by(self, owner: tuple[int, bool] | None, now: float, keep_grip: bool = False) -> None:
        """Sets id and side (whether left) of the hand that steers the arm `now` [s], None while no hand does; with
        `keep_grip` the grip is kept without it.
        """
        self._arm_reports, self._owner, self._reported_at = not self._hand_only, owner, now
        self._keep_grip = keep_grip and self._arm_reports

    def switch(self, gripper_on: bool) -> GripperResult | None:
        """Sets control of the gripper; returns the open pose if this switches it off, else None."""
        changed = gripper_on != self._gripper_on
        self._gripper_on = gripper_on
        return self._open(GRIPPER_OFF) if changed and not gripper_on else None

    def step(self, frame: TrackingFrame, now: float) -> GripperResult | None:
        """Processes a frame that arrived at `now` on a monotonic clock [s].

        Returns None for a repeated frame and for one with an old or future stamp.
        """
        arrival = self._watch.arrived(frame.id, frame.age, now)
        if not arrival.usable:
            return None
        self._opened_in_silence = False
        hand, absence = self._choose(frame, arrival.stamp, now)
        if self._gripper_on is None:
            return GripperResult(GripperState.WAITING, "waiting for kuka/gripper_control", None)
        if not self._gripper_on:
            return self._open(GRIPPER_OFF)
        if hand is None:
            return self._keep(absence, now)
        if hand.fingers is None:
            return self._keep(f"{hand.name} has not five fingers", now)
        try:
            angles = flexion(hand.palm, hand.normal, hand.fingers)
        except ValueError as error:
            return self._keep(f"{hand.name} has invalid numbers: {error}", now)
        self._state, self._followed_at = GripperState.FOLLOWING, now
        wanted = map_angles(angles, self._human, self._robot)
        self._kept &= np.abs(wanted - self._command) > NEAR * np.abs(np.diff(self._robot)[:, 0])
        self._command = read_only(np.where(self._kept, self._command, wanted))
        kept = ", ".join(finger for finger, keeps in zip(FINGERS, self._kept) if keeps)
        reason = f"{hand.name} is followed" + (f"; {kept} stay until the operator's come near" if kept else "")
        return GripperResult(GripperState.FOLLOWING, reason, self._command)

    def silence(self, now: float) -> GripperResult | None:
        """Returns the open pose, once, when no usable frame came for MAX_SILENCE_S, else None."""
        silence = self._watch.silence(now)
        if silence is None or self._opened_in_silence or self._gripper_on is None:
            return None
        result = self._keep(silence, now) if self._gripper_on else self._open(GRIPPER_OFF)
        self._opened_in_silence = result.state is GripperState.OPEN
        return result

    def _choose(self, frame: TrackingFrame, stamp: float, now: float) -> tuple[TrackedHand | None, str]:
        """Returns the owner as this frame shows it, or None and why."""
        hands = of_side(frame.hands, self._side)
        if self._arm_reports:
            if now - self._reported_at > MAX_UNREPORTED_S:
                return None, "leap_kuka does not report which hand steers the arm"
            if self._owner is None:
                return None, "no hand steers the arm; bring one into the interaction box"
            owner = next((hand for hand in hands if (hand.id, hand.is_left) == self._owner), None)
            return owner, "the hand that steers the arm is not seen"
        hand = self._lock.update(hands, stamp)
        if hand is None:
            return None, self._nobody
        if not self._lock.engaged and not self._lock.came_in:
            return None, f"{hand.name} was in view already; take it away and bring it back"
        self._lock.engage()
        return hand, ""

    def _keep(self, reason: str, now: float) -> GripperResult:
        """Keeps the grip for `grip_hold` after the hand was followed, or as leap_kuka says, then opens the hand."""
        if self._state not in (GripperState.FOLLOWING, GripperState.KEEPING):
            return self._open(reason)
        kept = self._keep_grip and now - self._reported_at <= MAX_UNREPORTED_S
        if not kept and now - self._followed_at >= self._grip_hold:
            self.counts.grips_opened += 1
            return self._open(reason)
        self._kept |= kept and self._owner is None
        self.counts.grips_kept += self._state is GripperState.FOLLOWING
        self._state = GripperState.KEEPING
        how_long = "while the tool stays" if kept else f"for {self._grip_hold:g} s"
        return GripperResult(GripperState.KEEPING, f"{reason}; the grip is kept {how_long}", None)

    def _open(self, reason: str) -> GripperResult:
        self._state, self._command = GripperState.OPEN, self.open_pose
        self._kept = np.zeros_like(self._kept)
        return GripperResult(GripperState.OPEN, reason, self.open_pose)

"""From tracking frames to commands of the robot hand: whom it follows, flexion, mapping, and when to open.

Arm and robot hand have one owner: the hand that leap_kuka has locked (`steered_by`), while it still reports that.
Without one any hand in view may move the fingers, by the same lock without a box; with `fingers_follow: steering` none.

The hand opens when gripper control is off, and `grip_hold` after the last good frame of its hand or as long as
leap_kuka keeps the tool: a held object must not fall. Until it has opened no other hand moves the fingers, and after an
engagement none that was in view then. At an engagement each finger keeps its command until the operator's comes near
it, if a grip was kept or another hand moved the fingers. Silence opens it once, after MAX_SILENCE_S."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from common.hand_tracking import ANY, FrameWatch, HandLock, of_side, succeeds
from common.operator_rows import OLD_ROWS_S
from common.poses import read_only
from common.reasons import FOLLOWED, IN_VIEW, NO_HAND, NOT_SEEN
from leap_hand.config import FINGERS, STEERING, HandConfig
from leap_hand.flexion import flexion, map_angles
from leap_hand.numbers import MAX_MISSING_S, MAX_SILENCE_S, NEAR
from leap_motion.frames import TrackedHand, TrackingFrame

GRIPPER_OFF = "the control of the gripper is off"


class GripperState(Enum):
    """What the robot hand does."""

    WAITING = "waiting"  # for the first message on kuka/gripper_control
    FOLLOWING = "following"  # the operator's hand
    KEEPING = "keeping"  # its grip, without the operator's hand
    OPEN = "open"

    @property
    def grips(self) -> bool:
        """Whether the fingers stand as a hand of the operator moved them."""
        return self in (GripperState.FOLLOWING, GripperState.KEEPING)


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
    """The chain of steps with its state; `open_pose` has the angles of the open robot hand, shape (4,) [rad]. With
    `hand_only` it starts without a message on kuka/gripper_control, and makes the lock itself. Hands of another side
    than `side` (LEFT, RIGHT or ANY of common.hand_tracking) do not exist for it."""

    def __init__(self, config: HandConfig, hand_only: bool, side: str = ANY) -> None:
        self._side = side
        self._steering_only = config.fingers_follow == STEERING
        self._human = config.human
        self._robot = config.robot
        self._grip_hold = config.grip_hold
        self.open_pose = read_only(self._robot[:, 0])
        self.counts = GripperCounts()
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._lock: HandLock[TrackedHand] = HandLock(max(MAX_MISSING_S, config.grip_hold))
        self._hand_only = hand_only
        self._arm_reports = False
        self._reported_at = -math.inf
        self._owner: tuple[int, bool] | None = None
        self._keep_grip = False
        self._led = False
        self._leads = False  # whether a program has moved the fingers since it leads
        self._gripper_on: bool | None = True if hand_only else None
        self._opened_in_silence = False
        self._state = GripperState.WAITING
        self._followed_at = -math.inf
        self._followed: tuple[TrackedHand, float] | None = None  # the hand as it was last, and its frame's stamp [s]
        self._command = self.open_pose  # that was sent last
        self._kept = np.zeros(len(self._robot), dtype=bool)  # fingers that keep it until the operator's come near

    def steered_by(
        self, owner: tuple[int, bool] | None, now: float, keep_grip: bool = False, led: bool = False
    ) -> None:
        """Sets id and side (whether left) of the hand that steers the arm `now` [s], None while no hand does; with
        `keep_grip` the grip is kept without it; `led`: a program steers."""
        if self._hand_only:
            return
        self._arm_reports = True
        self._owner = owner
        self._reported_at = now
        self._keep_grip = keep_grip
        self._led = led
        self._leads &= led
        if owner is not None or keep_grip:
            self._lock.end()

    def remap(self, config: HandConfig) -> bool:
        """Takes another mapping of the fingers, if control of the gripper is off; returns whether it is."""
        if self._gripper_on is not False:
            return False
        self._human, self._robot = config.human, config.robot
        self._command = self.open_pose = read_only(self._robot[:, 0])
        return True

    def switch(self, gripper_on: bool) -> GripperResult | None:
        """Sets control of the gripper; returns the open pose if this switches it off, else None."""
        changed = gripper_on != self._gripper_on
        self._gripper_on = gripper_on
        return self._open(GRIPPER_OFF) if changed and not gripper_on else None

    def lead(self, command: np.ndarray, now: float) -> GripperResult | None:
        """Moves the fingers to a program's command, shape (4,) [rad], as far as this hand's mapping goes, while a
        program steers the arm and control of the gripper is on; else returns None. Fingers that grip stay until the
        program's come near."""
        if not (self._led and self._gripper_on and now - self._reported_at <= OLD_ROWS_S):
            return None
        self._leads = True
        self._state = GripperState.KEEPING
        self._followed, self._followed_at = None, now
        wanted = np.clip(command, self._robot.min(axis=1), self._robot.max(axis=1))
        self._kept &= np.abs(wanted - self._command) > NEAR * np.abs(np.diff(self._robot)[:, 0])
        self._command = read_only(np.where(self._kept, self._command, wanted))
        return GripperResult(GripperState.KEEPING, "a program moves the fingers", self._command)

    def step(self, frame: TrackingFrame, now: float) -> GripperResult | None:
        """Processes a frame that arrived at `now` on a monotonic clock [s]. Returns None for a repeated frame and
        for one with an old or future stamp."""
        arrival = self._watch.arrived(frame.id, frame.age, now)
        if not arrival.usable:
            return None
        self._opened_in_silence = False
        if arrival.restarted:
            self._lock.end()
            self._lock.forget()
            self._followed = None
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
        self._kept |= self._state.grips and not self._continues(hand, frame, arrival.stamp)
        self._state = GripperState.FOLLOWING
        self._followed_at = now
        self._followed = (hand, arrival.stamp)
        wanted = map_angles(angles, self._human, self._robot)
        self._kept &= np.abs(wanted - self._command) > NEAR * np.abs(np.diff(self._robot)[:, 0])
        self._command = read_only(np.where(self._kept, self._command, wanted))
        kept = ", ".join(finger for finger, keeps in zip(FINGERS, self._kept) if keeps)
        reason = FOLLOWED.format(hand=hand.name) + (f"; {kept} stay until the operator's come near" if kept else "")
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
        """Returns the hand that moves the fingers as this frame shows it, or None and why."""
        hands = of_side(frame.hands, self._side)
        hand = self._lock.update(hands, stamp)
        refused = self._alone_refused(now)
        if refused or (self._state.grips and not self._lock.engaged):
            self._lock.end()
        if refused:
            return next((hand for hand in hands if self._steers(hand, now)), None), refused
        if hand is None:
            return None, NO_HAND[self._side]
        if not self._lock.engaged and not self._lock.came_in:
            return None, IN_VIEW.format(hand=hand.name)
        self._lock.engage()
        return hand, ""

    def _alone_refused(self, now: float) -> str:
        if self._hand_only:
            return ""
        if now - self._reported_at > OLD_ROWS_S:
            silent = self._arm_reports or self._steering_only
            return "leap_kuka does not report which hand steers the arm" if silent else ""
        if self._owner is not None:
            return NOT_SEEN.format(hand="the hand that steers the arm")
        refused = self._steering_only or self._keep_grip
        return "no hand steers the arm; bring one into the interaction box" if refused else ""

    def _steers(self, hand: TrackedHand, now: float) -> bool:
        return (hand.id, hand.is_left) == self._owner and now - self._reported_at <= OLD_ROWS_S

    def _continues(self, hand: TrackedHand, frame: TrackingFrame, stamp: float) -> bool:
        if self._followed is None:
            return False
        before, seen = self._followed
        key = before.id, before.is_left
        gone = key not in [(other.id, other.is_left) for other in frame.hands]
        return key == (hand.id, hand.is_left) or (gone and succeeds(hand, before, stamp - seen))

    def _keep(self, reason: str, now: float) -> GripperResult:
        """Keeps the grip for `grip_hold` after the hand was followed, or as leap_kuka says, then opens the hand."""
        if not self._state.grips:
            return self._open(reason)
        kept = self._keep_grip and now - self._reported_at <= OLD_ROWS_S
        if not kept and now - self._followed_at >= self._grip_hold:
            self.counts.grips_opened += 1
            return self._open(reason)
        self._kept |= kept and self._owner is None and not self._leads
        self.counts.grips_kept += self._state is GripperState.FOLLOWING
        self._state = GripperState.KEEPING
        how_long = "while the tool stays" if kept else f"for {self._grip_hold:g} s"
        return GripperResult(GripperState.KEEPING, f"{reason}; the grip is kept {how_long}", None)

    def _open(self, reason: str) -> GripperResult:
        self._state = GripperState.OPEN
        self._command = self.open_pose
        self._kept = np.zeros_like(self._kept)
        return GripperResult(GripperState.OPEN, reason, self.open_pose)

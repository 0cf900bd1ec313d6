"""From tracking frames to the desired tool frame of the arm: lock on a hand, filter, start gate, virtual Leap, tool.

A stream is one engagement of one hand (common.hand_tracking.HandLock). Poses are in the frame of the virtual Leap;
`T_base_virtual` is its pose in the robot's base; metres and radians. Where leap/hand names a side, other hands steer
nothing, but may clutch or enable. A relative stream starts where the tool is, and when it stops the tool is kept for
hold_time. While no hand steers, a program may hold the tool for the next one (tool_hold.py)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Callable

import numpy as np

from common.hand_tracking import ANY, MAX_STEP_M, FrameWatch, HandLock, of_side
from common.modes import FOLLOWS_TOOL, Mode
from common.poses import inverse, pose, read_only
from common.reasons import FOLLOWED, NO_HAND, Reason, ReasonCode, joined
from common.rotations import rotation_angle
from leap_kuka.config import RELATIVE, ArmPlacement, LeapConfig
from leap_kuka.engagement import EngagementState, EngagementTrigger, next_state
from leap_kuka.feasible_side import FeasibleSide
from leap_kuka.hand_average import HandAverage, MeanHand, hand_frame
from leap_kuka.kept_tool import Leaving, Measured, ToolBehind, kept, no_measured_tool, tool_at_home
from leap_kuka.numbers import (
    ENOUGH_RATE_HZ,
    LEAD_GONE_S,
    LEAD_NEAR_M,
    LEAD_NEAR_RAD,
    LEAD_SILENCE_S,
    MAX_HELD_TURN,
    MAX_SILENCE_S,
    MAX_STATUS_AGE_S,
    MIN_RATE_HZ,
    NOMINAL_RATE_HZ,
    PAUSE_S,
    REACH_LOOK_S,
    TURN_S,
)
from leap_kuka.operator_switches import OperatorSwitches
from leap_kuka.origin import FadingStep, StreamOrigin, absolute, relative, taken_over
from leap_kuka.scaling import NO_OFFSET, Scaling
from leap_kuka.start_gate import (
    BOX,
    CAME_IN,
    CONFIDENCE,
    OF_A_HAND,
    PITCH,
    RATE,
    REACH,
    READY,
    ROLL,
    StartGate,
    interaction_box,
)
from leap_kuka.teleop_result import StreamState, TeleopCounts, TeleopResult
from leap_kuka.tool_hold import Held, HoldAnswer, HoldState, hold_fault
from leap_kuka.virtual_leap import Attitude, SteadyAttitude, heading, virtual_leap_pose
from leap_motion.frames import TrackedHand, TrackingFrame

CONTROL_IS_OFF = EngagementTrigger.CONTROL_OFF.reason().text
CONTROLLER_SILENT = "the arm's controller is silent"
NEVER_LED = "a program needs leap/engagement relative, and a leap/hold_time above 0"
TOO_NEAR = "it is too near to the base, behind it or below its foot"
_HOLDS = {
    EngagementState.HELD: HoldState.HELD,
    EngagementState.LED: HoldState.LED,
    EngagementState.PAUSED: HoldState.KEPT,
    EngagementState.KEPT: HoldState.KEPT,
}
HAND_CAME_IN = {BOX, PITCH, ROLL, CAME_IN, REACH}  # what a hand that continues has fulfilled

CanReach = Callable[[np.ndarray, bool], "str | None"]


class ArmTeleop:
    """The chain of steps with its state; ConfigError: the interaction box would reach into the Leap.

    `box` is the interaction box in the Leap frame, `T_tool_flange` the flange in the tool frame, shape (4, 4), `counts`
    the events since the start. `can_reach` returns why the arm cannot come to a desired tool frame, shape (4, 4) [m],
    or None: it is asked before a stream `starts`, and every REACH_LOOK_S while one runs. `measured_tool` returns
    T_base_tool, shape (4, 4) [m], or raises ValueError; a relative stream needs it."""

    def __init__(
        self,
        leap: LeapConfig,
        arm: ArmPlacement,
        can_reach: CanReach = lambda T, starts: None,
        measured_tool: Measured = no_measured_tool,
    ) -> None:
        self._can_reach = can_reach
        self._asked = 0.0  # when, the last time [s]
        self._out_of_reach = ""
        self._mounting = arm.mounting_frame
        self._ws_center = arm.ws_center
        self._limits = Attitude(*np.radians([leap.run_tol_yaw, leap.run_tol_pitch, leap.run_tol_roll]).tolist())
        self._R_home = arm.R_level_home
        self.box = interaction_box(leap, arm)
        self._own_side = leap.hand
        self._side = leap.hand
        self.T_tool_flange = read_only(inverse(arm.T_flange_tool))
        self.counts = TeleopCounts()
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._lock: HandLock[TrackedHand] = HandLock(
            MAX_SILENCE_S, self.box.outside, TURN_S + leap.buffer_size / NOMINAL_RATE_HZ
        )
        self._average = HandAverage(leap.buffer_size, leap.filter)
        self._gate = StartGate(leap, self.box)
        self._relative = leap.engagement == RELATIVE
        self._hold_time = leap.hold_time
        self._keeps = self._relative and self._hold_time > 0.0  # whether the tool stays when a stream ends
        self._state = EngagementState.WAITING
        self._taken = False  # whether the stream took a held tool over
        self._held: Held | None = None
        self._hold_ended: Reason | None = None  # why, which is said once
        self._lead_allowed = False
        self._lead_at = -math.inf  # when a program's pose came last, or was allowed [s]
        self.lead_fault = ""  # why the newest pose of a program does not bring the tool on
        self._lead_fade = FadingStep(np.zeros(3), np.eye(3), 0.0)
        self._lead_ended: Reason | None = None  # why a program no longer brings the tool that is kept
        self._measured_tool = measured_tool
        self._behind = ToolBehind()
        self._left: Leaving | None = None  # how an engagement left the tool that is kept
        self._border = FeasibleSide(arm)
        self._at_border = False  # whether it acts on the newest tool
        self._mean: MeanHand | None = None  # in the newest frame
        self._measured: np.ndarray | None = None  # T_leap_hand of the newest frame
        self._unmet: frozenset[str] = OF_A_HAND  # conditions of a start
        self._name = ""  # of the hand that was followed last
        self._slow = False
        self._tool_at = -math.inf  # when a desired tool was returned last [s]
        self._newest: np.ndarray | None = None  # T_virtual_tool of the newest frame of the stream
        self._stays: np.ndarray | None = None  # the same while the tool stays because the tracker is slow
        self._obstacle: str | None = None
        self._ended: Reason | None = None  # why an engagement has ended, which is not said yet
        self._reason = Reason("no tracking frames come in", (ReasonCode.TRACKER_SILENT,))
        self._start_tool = np.eye(4)  # T_base_tool of the relative stream that starts
        self._mode = ""  # of the controller
        self._scaling = Scaling(arm.ws_center)
        self._status_at = -math.inf
        self._control_on: bool | None = None
        self.switches = OperatorSwitches(leap)
        self._heading = 0.0
        self._origin = self._absolute(0.0)
        self._attitude = SteadyAttitude(self._origin.R_leap_zero, 0.0, self._limits)

    def hold(self, T_base_tool: np.ndarray, duration: float, now: float) -> HoldAnswer:
        """Holds the tool at a pose, shape (4, 4) [m], for at most `duration` [s], until a hand takes it over there."""
        fault = hold_fault(T_base_tool, duration, self._mounting.up, self._R_home[2])
        fault = fault or self._hold_inhibited(T_base_tool, now)
        if fault:
            return HoldAnswer(False, f"The tool is not held: {fault}.")
        self._fire(EngagementTrigger.HOLD, now)
        self._held = Held(read_only(T_base_tool), now + duration)
        self._hold_ended = None
        self.counts.holds += 1
        return HoldAnswer(True, f"The tool is held for a hand, for {duration:g} s at most.")

    def _hold_inhibited(self, T_base_tool: np.ndarray, now: float) -> str:
        """Returns why no tool is held at a valid pose now, or an empty text."""
        state = self._state
        rows = (
            *self._program_inhibited(T_base_tool, now),
            (state.kept, "it is held already"),
            (state.held, "it is held already; end that hold first with a duration of 0"),
        )
        return _first(rows)

    def _program_inhibited(self, T_base_tool: np.ndarray, now: float) -> tuple[tuple[object, str], ...]:
        """Returns what keeps a program from bringing the tool to a valid pose: conditions, and their sentences."""
        silence = self._watch.silence(now) or ""
        return (
            (self._border.back(T_base_tool[:3, 3], self._scaling).any(), TOO_NEAR),
            (self._state.owned, "a hand is followed"),
            (silence, silence),
            (not self._control_on, CONTROL_IS_OFF),
            (self._mode not in FOLLOWS_TOOL, EngagementTrigger.ARM_LEFT.reason(detail=self._mode).text),
        )

    def allow_lead(self, allowed: bool, now: float) -> str:
        """Lets a program steer from now on, or no longer; returns why not, a part of a sentence, or an empty text. The
        permission ends by itself: with control, with the tool that an engagement has left, and where no pose comes for
        LEAD_GONE_S."""
        fault = _first(((not self._keeps, NEVER_LED), (not self._control_on, CONTROL_IS_OFF))) if allowed else ""
        self._lead_allowed, self._lead_at = allowed and not fault, now
        self.lead_fault = ""
        if not allowed:
            self._fire(EngagementTrigger.LEAD_LOST, now, "the program was stopped")
        return fault

    def lead(self, T_base_tool: np.ndarray, now: float) -> str:
        """Brings the tool, while no hand steers it, to the next pose of a program, shape (4, 4) [m]; returns why not,
        or an empty text. What is between the tool and the first pose fades out. Where a pose is refused, or the program
        silent for LEAD_SILENCE_S, the tool stays; a hand that comes in takes it over there."""
        self._lead_at = now
        fault = hold_fault(T_base_tool, LEAD_SILENCE_S, self._mounting.up, self._R_home[2])
        fault = fault or self._lead_inhibited(T_base_tool, now)
        if not fault:
            try:
                T_base_tool = self._led_tool(T_base_tool, now)
            except ValueError as error:
                fault = str(error)
        if fault:
            self._fire(EngagementTrigger.LEAD_LOST, now, fault)
            return fault
        self._fire(EngagementTrigger.LEAD, now)
        self._held = Held(read_only(T_base_tool), now + LEAD_SILENCE_S)
        self._hold_ended = self._left = None
        return ""

    def _look_for_lead(self, T_base_tool: np.ndarray | None, now: float) -> None:
        if T_base_tool is not None and self._lead_allowed:
            self.lead_fault = self.lead(T_base_tool, now)
        elif self._lead_allowed and now - self._lead_at > LEAD_GONE_S:
            self.allow_lead(False, now)
            self.lead_fault = f"no pose of it came for {LEAD_GONE_S:g} s, so it may no longer"

    def _lead_inhibited(self, T_base_tool: np.ndarray, now: float) -> str:
        stop = self.switches.stop
        not_ready = "" if self._state.held else self._not_ready(now)
        return _first(
            (
                (not self._keeps, NEVER_LED),
                *self._program_inhibited(T_base_tool, now),
                (not self._lead_allowed, "nobody has allowed it by leap_kuka/run_policy"),
                (self._state is EngagementState.HELD, "it is held for a hand"),
                (stop, stop.text if stop else ""),
                (not now - self._status_at <= MAX_STATUS_AGE_S, CONTROLLER_SILENT),
                (self._slow, self._slowness),
                (not_ready, not_ready),
            )
        )

    def _led_tool(self, T_base_tool: np.ndarray, now: float) -> np.ndarray:
        """Returns where a pose of a program brings the tool, shape (4, 4) [m]: nowhere before the arm follows. Raises
        ValueError if that is too far."""
        T_now = self._held.T_base_tool if self._held is not None else self._tool_of_arm()
        begins = self._state is not EngagementState.LED or self._mode != Mode.SERVO
        if begins:
            step = inverse(T_base_tool) @ T_now
            self._lead_fade = FadingStep(T_now[:3, 3] - T_base_tool[:3, 3], step[:3, :3], now)
        T = self._lead_fade.added(T_base_tool, now)
        far = inverse(T_now) @ (T_base_tool if begins else T)
        away, turned = float(np.linalg.norm(far[:3, 3])), rotation_angle(far[:3, :3])
        if (away > LEAD_NEAR_M or turned > LEAD_NEAR_RAD) if begins else _is_far(far):
            raise ValueError(f"its pose is {1e3 * away:.0f} mm and {math.degrees(turned):.0f} deg from the tool")
        return T

    def _tool_of_arm(self) -> np.ndarray:
        """Returns the desired tool at which the arm is at home; raises ValueError: it is unknown or elsewhere."""
        return self._scaling.unscaled(tool_at_home(self._measured_tool, self._ws_center))

    def end_hold(self) -> HoldAnswer:
        """Ends a hold on request; a hand that took the tool over continues, and so does a tool that is kept."""
        held = self._state is EngagementState.HELD
        self._fire(EngagementTrigger.HOLD_ENDED, 0.0)
        return HoldAnswer(True, "The hold has ended." if held else "The tool is not held.")

    def control(
        self,
        on: bool,
        mode: str = Mode.HOME.value,
        scale: float = 1.0,
        now: float = 0.0,
        offset: np.ndarray = NO_OFFSET,
    ) -> None:
        """Sets whether control of the arm is on, the controller's mode, and its scaling, as it says `now` [s]. The
        arm follows only a hand that comes in while control is on."""
        before = self._control_on
        self._control_on = on
        self._mode = mode
        self._scaling = Scaling(self._ws_center, scale, offset)
        self._status_at = now
        if not on:
            self._lead_allowed = False
            self._fire(EngagementTrigger.CONTROL_OFF, now)
        elif not before:
            self._lock.end()
            self._fire(EngagementTrigger.CONTROL_FOUND_ON if before is None else EngagementTrigger.CONTROL_ON, now)
        elif mode not in FOLLOWS_TOOL:
            self._fire(EngagementTrigger.ARM_LEFT, now, mode)

    def choose(self, elsewhere: str | None, any_hand: bool) -> None:
        """Sets why another arm is steered, a part of a sentence, or None; `any_hand`: whether any hand steers this
        one, not only that of leap/hand."""
        self.switches.elsewhere = elsewhere
        self._side = ANY if any_hand else self._own_side

    @property
    def frame_rate(self) -> float | None:
        """Tracking frames per second [Hz], None while it is unknown."""
        return self._watch.rate

    def step(self, frame: TrackingFrame, now: float, T_lead: np.ndarray | None = None) -> TeleopResult:
        """Processes the newest frame; `now` is its time of arrival on a monotonic clock [s]. `T_lead`: the pose to
        which a program wants to bring the tool, shape (4, 4) [m]; `lead_fault` says why it does not."""
        arrival = self._watch.arrived(frame.id, frame.age, now)
        if arrival.broken:
            self._lose_tracker(arrival.broken, now)
        if arrival.restarted:
            self._lock.forget()
        if self._held is not None and now >= self._held.until and not (self._state.kept and self.switches.stop):
            led = self._state is EngagementState.LED
            self._fire(EngagementTrigger.LEAD_LOST if led else EngagementTrigger.EXPIRED, now, "the program is silent")
        if not arrival.usable:
            self.counts.frames_refused += 1
            return self._result(False, now)
        self.counts.frames += 1
        rate = self._watch.rate
        self._slow = rate is not None and rate < (ENOUGH_RATE_HZ if self._slow else MIN_RATE_HZ)
        self._obstacle = self._mean = self._measured = None
        owner = self._lock.owner
        hand = self._lock.update(of_side(frame.hands, self._side), arrival.stamp)
        if self._state.owned and self._lock.owner is None:
            self._fire(EngagementTrigger.HAND_LOST, now)
        elif self._lock.changed:
            self._average.reset()
        self.counts.id_changes += self._lock.owner not in (owner, None)
        self._update_switches(frame, hand, arrival.stamp, now)
        if hand is not None:
            self._follow(hand, arrival.stamp, now)
        elif self._state.running:
            self.counts.frames_without_owner += 1
            self._keep_tool(self._fire(EngagementTrigger.NOT_SEEN, now))
        else:
            self._reason = Reason(NO_HAND[self._side], (ReasonCode.NO_HAND,))
        if self._ended is not None:
            self._reason = self._ended
            self._ended = None
        self._look_for_lead(T_lead, now)
        if self._state.running:
            if self._keeps and self._newest is not None:
                self._behind.look(self._measured_tool, self._T_base_scaled(self._newest), now)
        elif self._mean is None:
            resumes = self._state is EngagementState.PAUSED
            self._unmet = OF_A_HAND - (HAND_CAME_IN if resumes else set()) | self._obstacles(resumes, now).keys()
        if self._state is EngagementState.LED and self._held is not None:
            self._behind.look(self._measured_tool, self._scaled(self._held.T_base_tool), now)
        self._move_kept(now)
        result = self._result(True, now)
        self._tool_at = self._tool_at if result.T_virtual_tool is None else now
        return result

    def silence(self, now: float) -> TeleopResult | None:
        """Ends the stream if no usable frame came for MAX_SILENCE_S; returns that result, or None while frames come."""
        silence = self._watch.silence(now)
        if silence is None:
            return None
        self._lose_tracker(silence, now)
        self.switches.update([], now, now, False)
        self._unmet = OF_A_HAND | {RATE} | self._obstacles(False, now).keys()
        return self._result(False, now)

    def _lose_tracker(self, why: str, now: float) -> None:
        self._fire(EngagementTrigger.TRACKER_LOST, now, why)
        self._forget_hand()
        self._reason = Reason(why, (ReasonCode.TRACKER_SILENT,))

    def _fire(self, trigger: EngagementTrigger, now: float, detail: str = "", code: ReasonCode | None = None) -> Reason:
        reason = trigger.reason(self._name, detail, code)
        before = self._state
        after = self._state = next_state(before, trigger, self._relative, self._keeps and bool(self._control_on))
        if after is before:
            return reason
        if after is EngagementState.WAITING:
            self._lead_allowed = False
        self._lead_ended = reason if after.kept and before is EngagementState.LED else None
        if after is EngagementState.WAITING and before.held:
            self._hold_ended = replace(reason, text=f"the tool is no longer held: {reason.text}")
        if after.kept and before.running:
            self._keep(now)
        elif after.kept and before is EngagementState.LED and self._held is not None:
            self._held = replace(self._held, until=now + self._hold_time)
            if self._mode == Mode.SERVO:
                self._left = self._behind.leave(self._measured_tool, self._scaled(self._held.T_base_tool), now)
        elif not after.held:
            self._held = self._left = None
        if before.owned and not after.owned:
            self._lock.end()
            self._reason = self._ended = reason
            if trigger is not EngagementTrigger.UNSURE:  # its mean still tells why
                self._forget_hand()
        return reason

    def _forget_hand(self) -> None:
        self._average.reset()
        self._mean = self._measured = None

    def _update_switches(self, frame: TrackingFrame, hand: TrackedHand | None, stamp: float, now: float) -> None:
        owner = self._lock.owner
        switches = self.switches
        number, side = owner or ((hand.id, hand.is_left) if hand is not None else (None, None))
        others = [other for other in frame.hands if side is (not other.is_left) and other.id != number]
        if self._state is EngagementState.LED and owner is None:
            others = list(frame.hands)  # the first hand that comes may be the one that stops
        keeps = self._state.kept or self._state is EngagementState.LED
        switches.update(others, stamp, now, owner is not None or keeps)
        if switches.lost:
            self._fire(EngagementTrigger.CLUTCH_LOST, now)
        stop = switches.stop
        if stop is not None:
            self.counts.clutched += self._state.running and switches.clutched
            self._fire(EngagementTrigger.STOPPED, now, stop.text, *stop.codes)
            if self._state.kept and self._held is not None:
                self._held = replace(self._held, until=now + self._hold_time)

    def _keep(self, now: float) -> None:
        """Keeps the tool where the relative stream wants it, or nearer to an arm that is far behind."""
        assert self._newest is not None, "a stream runs from the frame on in which it brought the tool somewhere"
        self.counts.kept += 1
        self._held = Held(read_only(self._origin.T_base_virtual @ self._newest), now + self._hold_time)
        self._hold_ended = self._left = None
        if self._mode == Mode.SERVO:
            self._left = self._behind.leave(self._measured_tool, self._T_base_scaled(self._newest), now)

    def _move_kept(self, now: float) -> None:
        if self._left is None or self._held is None or self._scaling.fault:
            return
        T_base_tool = kept(self._left, self._measured_tool, now)
        if T_base_tool is not None:
            self._held = replace(self._held, T_base_tool=self._scaling.unscaled(T_base_tool))

    def _T_base_scaled(self, T_virtual_tool: np.ndarray) -> np.ndarray:
        """Returns where the controller's scaling brings a desired tool, shape (4, 4) [m]."""
        return self._scaled(self._origin.T_base_virtual @ T_virtual_tool)

    def _scaled(self, T: np.ndarray) -> np.ndarray:
        return pose(T[:3, :3], self._scaling.scaled(T[:3, 3]))

    def _follow(self, hand: TrackedHand, stamp: float, now: float) -> None:
        self._name = hand.name
        left_out = self._average.add(hand, stamp)
        if not left_out:
            self._measured = hand_frame(hand)
        self._mean = mean = self._average.mean()
        if left_out:
            self.counts.samples_left_out += 1
            self._reason = Reason(f"{hand.name}: {left_out}", (ReasonCode.HAND_JUMPED,))
        elif mean is None and not self._average.full:
            samples = f"{self._average.count} of {self._average.size} samples are in"
            self._reason = Reason(f"{hand.name}: {samples}", (ReasonCode.FILLING,))
        elif mean is None:
            self._reason = Reason(f"{hand.name} turns too fast", (ReasonCode.TOO_FAST,))
        elif self._state.running:
            self._steer(mean, now)
        else:
            self._try_start(mean, now)
        if self._average.lost or (self._state.running and mean is None):
            why = f": {left_out or 'it turns too fast'}"
            self._fire(EngagementTrigger.HAND_LOST, now, why, ReasonCode.HAND_JUMPED)
            self._forget_hand()

    def _try_start(self, mean: MeanHand, now: float) -> None:
        resumes = self._state is EngagementState.PAUSED
        obstacles = self._obstacles(resumes, now)
        faults = self._gate.faults(mean, obstacles, resumes)
        unasked = {REACH} if faults and not self._relative else set()  # a relative stream starts where the arm is
        faults = faults or self._start_fault(mean)
        self._unmet = frozenset({*faults, *obstacles, *unasked})
        self._reason = joined(f"{self._name}: ", faults.values()) if faults else self._start(mean, now)

    def _steer(self, mean: MeanHand, now: float) -> None:
        """Lets the tool follow the hand of the stream, or stay while the arm or the tracker is not ready."""
        unsure = self._gate.confidence_fault(mean)
        if unsure:
            self._unmet = frozenset(unsure)
            self._fire(EngagementTrigger.UNSURE, now, unsure[CONFIDENCE].text)
            return
        self._reason = Reason(FOLLOWED.format(hand=self._name), (ReasonCode.FOLLOWED,))
        if self._relative and self._mode != Mode.SERVO:
            self._begin_at_tool(mean)
            self._keep_tool(self._fire(EngagementTrigger.ARM_BUSY, now, self._mode))
            return
        if self._relative and self._average.spans_gap and not self._slow and self._stays is None:
            self._begin_at_tool(mean)
            return
        self._fire(EngagementTrigger.ARM_READY, now)
        self._attitude.follow(self._origin.turn(mean.T_leap_hand[:3, :3]))
        if self._slow:
            self.counts.slow_frames += 1
            self._stays = self._newest if self._stays is None else self._stays
            slow = f"{self._slowness}; the tool stays until {ENOUGH_RATE_HZ:g} come"
            self._keep_tool(self._fire(EngagementTrigger.SLOW, now, slow))
            return
        stayed = self._stays
        self._stays = None
        moved = stayed is not None and _is_far(inverse(stayed) @ self._tool(mean, now))
        self._fire(EngagementTrigger.MOVED if moved else EngagementTrigger.SEEN, now)

    def _begin_at_tool(self, mean: MeanHand) -> None:
        """Lets a relative stream begin anew with the hand as it is now; the tool stays where it is."""
        assert self._newest is not None, "a stream runs from the frame on in which it brought the tool somewhere"
        self._stays = None
        T_base_tool = self._origin.T_base_virtual @ self._newest
        self._begin(relative(T_base_tool, self._origin.T_base_virtual[:3, :3], mean.T_leap_hand), mean)

    def _keep_tool(self, reason: Reason) -> None:
        self._reason = reason
        self._obstacle = reason.text

    def _obstacles(self, resumes: bool, now: float) -> dict[str, Reason]:
        """Returns the conditions of a start that are not met and not the hand's own, the first one to say first."""
        obstacles = {}
        if not self._lock.came_in and not resumes:
            came_in = "it was in the box already, or was found there; take it out of the box and back in"
            obstacles[CAME_IN] = Reason(came_in, (ReasonCode.IN_BOX_ALREADY,))
        obstacles.update(self.switches.stops)
        not_ready = self._not_ready(now)
        if not_ready:
            obstacles[READY] = Reason(not_ready, (ReasonCode.ARM_NOT_READY,))
        if self._slow:
            slow = f"{self._slowness}, and {ENOUGH_RATE_HZ:g} are needed"
            obstacles[RATE] = Reason(slow, (ReasonCode.TRACKER_SLOW,))
        return obstacles

    def _not_ready(self, now: float) -> str:
        """Returns why no hand may steer the arm yet, or an empty text; a held tool is there already."""
        held = self._state.held
        rows = (
            (
                not held and now - self._tool_at <= PAUSE_S,
                f"the arm still waits for the hand before, {PAUSE_S:g} s after its last frame",
            ),
            (
                not held and self._relative and self._mode != Mode.HOME,
                f"the arm is not at home, its controller is in the mode {self._mode or 'unknown'}",
            ),
            (self._relative and not self._control_on, CONTROL_IS_OFF),
            (self._relative and not now - self._status_at <= MAX_STATUS_AGE_S, CONTROLLER_SILENT),
        )
        return _first(rows)

    @property
    def _slowness(self) -> str:
        return f"the tracker delivers only {self._watch.rate or 0.0:.0f} frames per second"

    def _start_fault(self, mean: MeanHand) -> dict[str, Reason]:
        """Returns the condition and the sentence of what inhibits a start that is allowed otherwise, if anything: the
        arm cannot come to where the hand would start, or it is unknown where the tool is. A held tool is there already.
        """
        if self._held is not None:
            self._start_tool = self._held.T_base_tool
            return {}
        if self._relative:
            try:
                self._start_tool = self._tool_of_arm()
            except ValueError as error:
                return {READY: Reason(f"where the tool is cannot be said: {error}", (ReasonCode.ARM_NOT_READY,))}
            return {}
        R_leap_hand = mean.T_leap_hand[:3, :3]
        origin = self._absolute(heading(R_leap_hand[:, 0]))
        clipped = SteadyAttitude(origin.turn(R_leap_hand), 0.0, self._limits).clipped
        reason = self._can_reach(origin.T_base_virtual @ pose(origin.rotation(clipped, 0.0), mean.palm), True)
        return {REACH: Reason(reason, (ReasonCode.OUT_OF_REACH,))} if reason else {}

    def _start(self, mean: MeanHand, now: float) -> Reason:
        """Starts the stream of the hand, where the tool is held or is, if it is held or the engagement relative, and
        returns the reason. A hand that continues keeps its directions."""
        R_leap_hand = mean.T_leap_hand[:3, :3]
        held = self._held
        if self._state is not EngagementState.PAUSED:
            self._heading = heading(R_leap_hand[:, 0])
        self._taken = self._state in (EngagementState.HELD, EngagementState.LED)
        reason = self._fire(EngagementTrigger.HAND_READY, now)
        self._lock.engage()
        origin = self._absolute(self._heading)
        if self._relative:
            origin = relative(self._start_tool, origin.T_base_virtual[:3, :3], mean.T_leap_hand)
        elif held is not None:
            angles = SteadyAttitude(origin.turn(R_leap_hand), 0.0, self._limits).clipped
            origin = taken_over(origin, held.T_base_tool, angles, mean.palm, now)
        self._begin(origin, mean)
        self._stays = None
        self._asked = now
        self._out_of_reach = ""
        self.counts.streams += 1
        return reason

    def _begin(self, origin: StreamOrigin, mean: MeanHand) -> None:
        self._origin = origin
        self._attitude = SteadyAttitude(origin.turn(mean.T_leap_hand[:3, :3]), 0.0, self._limits)

    def _absolute(self, psi: float) -> StreamOrigin:
        T_base_virtual = read_only(virtual_leap_pose(self._mounting, self._ws_center, self.box.center, psi))
        return absolute(T_base_virtual, psi, self._mounting.tool_reversed, self._R_home)

    def _tool(self, mean: MeanHand, now: float) -> np.ndarray:
        T_base_virtual = self._origin.T_base_virtual
        R_base_virtual = T_base_virtual[:3, :3]
        out = self._border.back(R_base_virtual @ mean.palm + T_base_virtual[:3, 3], self._scaling)
        self._at_border = bool(np.any(out))
        position = mean.palm + R_base_virtual.T @ out if self._at_border else mean.palm
        return pose(self._origin.rotation(self._attitude.clipped, now), position)

    def _result(self, usable: bool, now: float) -> TeleopResult:
        mean = self._mean
        state = self._state
        switches = self.switches
        T_base_virtual = self._origin.T_base_virtual
        T_virtual_filtered = None if mean is None else mean.T_leap_hand
        hold_ended = self._hold_ended
        self._hold_ended = None
        more: dict[str, Any] = {"enabled": switches.enabled, "clutched": switches.clutched, "source": switches.source}
        if not state.running:
            T_virtual_tool = None
            reason = self._reason
            left = 0.0
            if self._held is not None:
                T_virtual_tool = read_only(inverse(T_base_virtual) @ self._held.T_base_tool)
                left = max(self._held.until - now, 0.0)
            if state is EngagementState.LED:
                reason = EngagementTrigger.LEAD.reason()
            elif self._lead_ended is not None:
                reason = self._lead_ended
            if state.kept:
                reason = replace(reason, text=f"{reason.text}; the tool stays for {math.ceil(left)} s")
            return TeleopResult(
                StreamState.WAITING,
                (hold_ended or reason).text,
                usable,
                T_base_virtual,
                self._measured,
                T_virtual_filtered,
                T_virtual_tool,
                hold=_HOLDS.get(state, HoldState.NONE),
                keep_grip=state.kept or state is EngagementState.LED,
                hold_left=left,
                unmet=self._unmet,
                codes=(hold_ended or reason).codes,
                **more,
            )
        if self._newest is not None and now - self._asked >= REACH_LOOK_S:
            self._asked = now
            self._out_of_reach = self._can_reach(T_base_virtual @ self._newest, False) or ""
        if self._out_of_reach and self._obstacle is None:
            text = f"{FOLLOWED.format(hand=self._name)}, but {self._out_of_reach}"
            self._keep_tool(Reason(text, (ReasonCode.OUT_OF_REACH,)))
        reason = self._reason
        T_virtual_tool = None
        measured = None
        clipped = None
        if mean is not None:
            T_virtual_tool = read_only(self._tool(mean, now)) if self._stays is None else self._stays
            self._newest = T_virtual_tool
            measured = self._attitude.measured
            clipped = self._attitude.clipped
            limited = self._attitude.limited + ["position"] * self._at_border
            more["limits"] = tuple(limited)
            if limited:
                reason = replace(reason, text=f"{reason.text}; {' and '.join(limited)} at the limit")
        elif self._keeps:  # the arm must not go home before the hold begins
            T_virtual_tool = self._newest
        return TeleopResult(
            state=StreamState.RUNNING,
            reason=reason.text,
            codes=reason.codes,
            usable=usable,
            T_base_virtual=T_base_virtual,
            T_virtual_hand=self._measured,
            T_virtual_filtered=T_virtual_filtered,
            T_virtual_tool=T_virtual_tool,
            measured=measured,
            clipped=clipped,
            hold=HoldState.TAKEN if self._taken else HoldState.NONE,
            owner=self._lock.owner,
            obstacle=self._obstacle,
            keep_grip=self._keeps,
            **more,
        )


def _first(rows: Iterable[tuple[object, str]]) -> str:
    """Returns the sentence of the first row whose condition holds, or an empty text."""
    return next((sentence for holds, sentence in rows if holds), "")


def _is_far(step: np.ndarray) -> bool:
    """Returns whether a motion of the tool, shape (4, 4) [m], is too large to be made at once."""
    return float(np.linalg.norm(step[:3, 3])) > MAX_STEP_M or rotation_angle(step[:3, :3]) > MAX_HELD_TURN

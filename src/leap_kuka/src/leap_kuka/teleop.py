"""From tracking frames to the desired tool frame of the arm: lock on a hand, filter, start gate, virtual Leap, tool.

One object composes the steps. A stream is one engagement of one hand (common.hand_tracking.HandLock). While that hand
is missing, or the tracker is slower than MIN_RATE_HZ, the stream runs on and the tool stays. Poses are in the frame of
the virtual Leap, which has the same coordinates as the real Leap's frame; `T_base_virtual` is its pose in the robot's
base frame; metres and radians.

Where leap/hand names a side, the other hands steer nothing; as second hand, which clutches or enables, they count. Of
several arms one may be chosen for any hand (arm_choice.py): the tools of the others stay, as with the clutch.

While no hand steers, the tool may be held at a pose for a hand that then starts from there (tool_hold.py): as long as
tracking frames come in and control of the arm is on.

With relative engagement (relative.py) a stream starts where the tool is. When it stops, the tool is kept, for hold_time
from the time on when the clutch is released and enabling pressed. After the clutch or a released enabling device the
same hand continues where it is; after any other end, a hand must come in as at the start.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from enum import Enum
from typing import Any, Callable

import numpy as np

from common.hand_tracking import ANY, LONG_GAP_S, MAX_STEP_M, FrameWatch, HandLock, of_side
from common.poses import inverse, pose, read_only
from common.rotations import rotation_angle
from leap_kuka.config import RELATIVE, ArmPlacement, LeapConfig
from leap_kuka.feasible_side import FeasibleSide
from leap_kuka.hand_average import NOMINAL_RATE_HZ, HandAverage, MeanHand, hand_frame
from leap_kuka.operator_switches import OperatorSwitches
from leap_kuka.relative import RelativeMotion, relative_motion, unscaled
from leap_kuka.start_gate import (
    BOX,
    CAME_IN,
    CHOSEN,
    ENABLED,
    OF_A_HAND,
    PITCH,
    RATE,
    REACH,
    READY,
    RELEASED,
    ROLL,
    StartGate,
    interaction_box,
)
from leap_kuka.tool_hold import HandOver, HoldAnswer, HoldState, ToolHold, hand_over
from leap_kuka.virtual_leap import Attitude, SteadyAttitude, heading, tool_rotation, virtual_leap_pose
from leap_motion.frames import TrackedHand, TrackingFrame

MAX_SILENCE_S = 0.2  # longest time between two tracking frames of one stream, or two frames with its hand
TURN_S = 0.5  # how long a hand whose mean is full may start, before another hand in the box has its turn
MIN_RATE_HZ, ENOUGH_RATE_HZ = 20.0, 24.0  # below the first frame rate the tool stays, until the second is reached
REACH_PERIOD_S = 0.2  # time between two questions whether the arm reaches the desired tool
PAUSE_S, PAUSE_MARGIN_S = 0.2, 0.1
"""The controller sees a new stream after a pause of 0.2 s, and goes home after `time_out`. Another engagement waits for
both, and for the delay on the way, so that it never continues the stream of the one before."""
MAX_HELD_TURN = np.radians(10.0)  # farther, or by more than MAX_STEP_M, no tool moves at once when the rate is back
MAX_LAG_M = 0.03  # a tool that is farther behind the desired one is kept where it is

MAX_STATUS_AGE_S = 1.5  # of the controller's, for a relative start
AT_HOME, SERVO = "home", "servo"  # modes of the controller: the first relative stream starts at home
HAND_CAME_IN = {BOX, PITCH, ROLL, CAME_IN, REACH}  # what a hand that continues has fulfilled
FOLLOWS = (AT_HOME, "pick_up", SERVO)  # modes in which it follows the desired tool, or is about to

CanReach = Callable[[np.ndarray, bool], "str | None"]


def no_measured_tool() -> np.ndarray:
    """Raises ValueError: nobody measures the tool."""
    raise ValueError("the measured tool is unknown")


class StreamState(Enum):
    """Whether a hand steers the arm."""

    WAITING = "waiting"
    RUNNING = "running"


@dataclass(frozen=True)
class TeleopResult:
    """The result of a frame; poses have shape (4, 4)."""

    state: StreamState  # RUNNING while the hand steers
    reason: str  # one sentence: which hand is followed, or what the stream waits for
    usable: bool  # whether the frame was new and current; only then its poses are to be published
    T_base_virtual: np.ndarray  # pose of the virtual Leap in the base frame
    T_virtual_hand: np.ndarray | None = None  # pose of the hand as measured in this frame, if it has a valid sample
    T_virtual_filtered: np.ndarray | None = None  # pose of the averaged or filtered hand, if there is one
    T_virtual_tool: np.ndarray | None = None  # pose of the desired tool while the stream runs or the tool is held
    measured: Attitude | None = None  # of the hand relative to the heading of its stream, while that runs
    clipped: Attitude | None = None  # the same with each angle within its limit
    hold: HoldState = HoldState.NONE  # HELD while the tool is held, TAKEN while the hand that took it over steers
    owner: tuple[int, bool] | None = None  # id of the hand that steers, and whether it is a left one
    obstacle: str | None = None  # why the tool does not follow the hand although the stream runs
    keep_grip: bool = False  # whether the robot hand keeps its grip when it does not see the hand that steers
    hold_left: float = 0.0  # time until the hold ends [s]
    unmet: frozenset[str] = frozenset()  # of start_gate.CONDITIONS; none while the stream runs
    enabled: bool = True
    clutched: bool = False
    source: str = ""  # what enables or clutches
    limits: tuple[str, ...] = ()  # angles of the hand that are at their limit; "position": see feasible_side

    @property
    def follows(self) -> bool:
        """Whether the tool follows the hand."""
        return self.state is StreamState.RUNNING and self.obstacle is None


@dataclass
class TeleopCounts:
    """Events since the start."""

    frames: int = 0
    frames_refused: int = 0
    samples_left_out: int = 0
    streams: int = 0
    id_changes: int = 0  # of the hand that steers
    frames_without_owner: int = 0
    slow_frames: int = 0  # in which the tool stayed because the tracker was slow
    holds: int = 0
    kept: int = 0  # times that the tool stayed for the next relative engagement
    clutched: int = 0  # of them, times by the clutch


class ArmTeleop:
    """The chain of steps with its state.

    `box` is the interaction box in the Leap frame, `T_tool_flange` the pose of the flange in the tool frame, shape
    (4, 4), and `counts` has the events since the start. `can_reach` returns why the arm cannot come to a desired tool
    frame, shape (4, 4) [m], or None: it is asked last before a stream `starts`, and every REACH_PERIOD_S while it runs.
    `measured_tool` returns the measured T_base_tool, shape (4, 4) [m], or raises ValueError with what is wrong with it:
    it is asked last before a relative stream starts where no tool is held.

    Raises:
        ConfigError: the interaction box would reach into the Leap.
    """

    def __init__(
        self,
        leap: LeapConfig,
        arm: ArmPlacement,
        can_reach: CanReach = lambda T, starts: None,
        measured_tool: Callable[[], np.ndarray] = no_measured_tool,
    ) -> None:
        self._can_reach, self._asked, self._out_of_reach = can_reach, 0.0, ""
        self._mounting = arm.mounting_frame
        self._ws_center = arm.ws_center
        self._limits = Attitude(*np.radians([leap.run_tol_yaw, leap.run_tol_pitch, leap.run_tol_roll]).tolist())
        self._R_level_home = arm.R_level_home if arm.use_home_pos else None
        self.box, self._side = interaction_box(leap, arm), leap.hand
        self._own_side = leap.hand
        self.T_tool_flange = read_only(inverse(arm.T_flange_tool))
        self.counts = TeleopCounts()
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._lock: HandLock[TrackedHand] = HandLock(
            MAX_SILENCE_S, self.box.outside, TURN_S + leap.buffer_size / NOMINAL_RATE_HZ
        )
        self._average = HandAverage(leap.buffer_size, leap.filter)
        self._gate = StartGate(leap, self.box)
        self._control_known = False
        self._attitude = SteadyAttitude(np.eye(3), 0.0, self._limits)
        self._border, self._stopped_by = FeasibleSide(arm), False  # the second: whether it acts on the newest tool
        self._mean: MeanHand | None = None  # in the newest frame
        self._measured: np.ndarray | None = None  # T_leap_hand of the newest frame
        self._name = ""  # of the hand that was followed last
        self._slow = False
        self._pause = max(PAUSE_S, arm.time_out) + PAUSE_MARGIN_S
        self._tool_at = -math.inf  # when a desired tool was returned last [s]
        self._newest: np.ndarray | None = None  # T_virtual_tool of the newest frame of the stream
        self._stays: np.ndarray | None = None  # the same while the tool stays because the tracker is slow
        self._obstacle: str | None = None
        self._reason = "no tracking frames come in"
        self._hold = ToolHold(self._mounting.up, arm.R_level_home[2])
        self._hand_over: HandOver | None = None
        self._is_relative, self._hold_time = leap.engagement == RELATIVE, leap.hold_time
        self._keeps = self._is_relative and self._hold_time > 0.0  # whether the tool stays when a stream ends
        self._measured_tool = measured_tool
        self._start_tool = np.eye(4)  # T_base_tool of the relative stream that starts
        self._relative: RelativeMotion | None = None
        self._taken = False  # whether the stream took over a tool that was held on request
        self._mode, self._scale, self._status_at = "", 1.0, -math.inf  # of the controller
        self._control_on = False
        self._seen_at, self._begins = 0.0, 0  # stamp of the newest sample; frames left in which the mean knows a gap
        self.switches = OperatorSwitches(leap)
        self._T_base_virtual: np.ndarray
        self._turn(0.0)

    def hold(self, T_base_tool: np.ndarray, duration: float, now: float) -> HoldAnswer:
        """Holds the tool at a pose, shape (4, 4) [m], for at most `duration` [s], until a hand takes it over there."""
        inhibit_reason = "a hand is followed" if self._lock.owner is not None else self._watch.silence(now)
        answer = self._hold.start(T_base_tool, duration, now, inhibit_reason)
        self.counts.holds += answer.success
        return answer

    def end_hold(self) -> HoldAnswer:
        """Ends a hold on request; a hand that took the tool over continues, and so does a tool that is kept."""
        held = self._hold.held is not None and not self._hold.kept
        if held:
            self._hold.end("it was ended")
        return HoldAnswer(True, "The hold has ended." if held else "The tool is not held.")

    def control(self, on: bool, mode: str = AT_HOME, scale: float = 1.0, now: float = 0.0) -> None:
        """Sets whether control of the arm is on, the controller's mode, and its scaling factor, as it says `now` [s].

        Control off ends a hold. It ends a relative stream, too, as does an arm that no longer follows. Where control is
        on from the beginning, this program was started anew, perhaps under the operator's hand.
        """
        if on and not self._control_known:
            self._lock.end()
            self._end(
                "control of the arm was on at the start; take the hand out of the box and back in", now, keep=False
            )
        self._control_known = True
        self._control_on, self._mode, self._scale, self._status_at = on, mode, scale, now
        self._hold.control(on)
        if self._is_relative and (self._lock.owner is not None or self._hold.kept) and not (on and mode in FOLLOWS):
            end = (
                f"the arm does not follow, its controller is in the mode {mode}" if on else "control of the arm is off"
            )
            self._end(end, now, keep=False)

    def choose(self, elsewhere: str | None, any_hand: bool) -> None:
        """Sets why another arm is steered, a part of a sentence, or None; `any_hand`: whether any hand steers this one,
        not only that of leap/hand.
        """
        self.switches.elsewhere, self._side = elsewhere, ANY if any_hand else self._own_side

    @property
    def frame_rate(self) -> float | None:
        """Tracking frames per second [Hz], None while it is unknown."""
        return self._watch.rate

    def step(self, frame: TrackingFrame, now: float) -> TeleopResult:
        """Processes the newest frame; `now` is its time of arrival on a monotonic clock [s]."""
        ran = self._gate.running
        arrival = self._watch.arrived(frame.id, frame.age, now)
        end = arrival.broken
        if end:
            self._end(end, now, keep=False)
        if arrival.restarted:
            self._lock.forget()
        if not (self._hold.kept and self.switches.stop):
            self._hold.expire(now)
        if not arrival.usable:
            self.counts.frames_refused += 1
            return self._result(False, now)
        self.counts.frames += 1
        rate = self._watch.rate
        self._slow = rate is not None and rate < (ENOUGH_RATE_HZ if self._slow else MIN_RATE_HZ)
        self._obstacle = self._mean = self._measured = None
        if self._lock.owner is not None and not self._gate.running and self._hold.T_base_tool is None:
            self._end("the hold has ended", now, keep=False)
        owner = self._lock.owner
        hand = self._lock.update(of_side(frame.hands, self._side), arrival.stamp)
        if owner is not None and self._lock.owner is None:
            end = f"{self._name} was lost"
            self._end(end, now, keep=True)
        elif self._lock.changed:
            self._average.reset()
        self.counts.id_changes += self._lock.owner not in (owner, None)
        end = self._update_switches(frame, hand, arrival.stamp, now) or end
        if hand is not None:
            self._follow(hand, arrival.stamp, now)
        elif self._gate.running:
            self.counts.frames_without_owner += 1
            self._reason = self._obstacle = f"{self._name} is not seen; the tool stays"
        else:
            self._reason = "no hand is seen" if self._side == ANY else f"no {self._side} hand is seen"
        if ran and end:
            self._reason = end
        if not self._gate.running and self._mean is None:
            resumes = self._lock.owner is not None
            self._gate.unmet = OF_A_HAND - (HAND_CAME_IN if resumes else set()) | self._obstacles(resumes, now).keys()
        result = self._result(True, now)
        self._tool_at = self._tool_at if result.T_virtual_tool is None else now
        return result

    def silence(self, now: float) -> TeleopResult | None:
        """Ends the stream if no usable frame came for MAX_SILENCE_S; returns that result, or None while frames come."""
        silence = self._watch.silence(now)
        if silence is None:
            return None
        self._end(silence, now, keep=False)
        self.switches.update([], now, now, False)
        self._gate.unmet = OF_A_HAND | {RATE} | self._obstacles(False, now).keys()
        return self._result(False, now)

    def _update_switches(self, frame: TrackingFrame, hand: TrackedHand | None, stamp: float, now: float) -> str | None:
        """Updates enabling and clutch, which are not by the hand that steers; returns why the stream ends, or None."""
        owner, switches = self._lock.owner, self.switches
        number, side = owner or ((hand.id, hand.is_left) if hand is not None else (None, None))
        others = [other for other in frame.hands if side is (not other.is_left) and other.id != number]
        switches.update(others, stamp, now, owner is not None or self._hold.kept)
        if self._hold.kept and switches.stop:
            self._hold.renew(self._hold_time, now)
        if owner is not None and switches.lost:
            self._end(switches.lost, now, keep=True)
            return switches.lost
        if not self._gate.running or not switches.stop:
            return None
        self.counts.clutched += switches.clutched
        self._keep(now)
        self._gate.stop()
        return None

    def _keep(self, now: float) -> None:
        """Keeps the tool where the relative stream wants it, or where it is, if it is far behind."""
        assert self._newest is not None, "a stream runs from the frame on in which it brought the tool somewhere"
        self.counts.kept += 1
        T_base_tool = self._T_base_virtual @ self._newest
        if self._mode == SERVO:
            with contextlib.suppress(ValueError):
                T_measured = unscaled(self._measured_tool(), self._ws_center, self._scale)
                if self._scale * np.linalg.norm((T_measured - T_base_tool)[:3, 3]) > MAX_LAG_M:
                    T_base_tool = T_measured
        self._hold.keep(T_base_tool, self._hold_time, now)

    def _follow(self, hand: TrackedHand, stamp: float, now: float) -> None:
        """Adds a sample of the followed hand to the mean, and updates the gate."""
        self._name = hand.name
        left_out = self._average.add(hand, stamp)
        if not left_out:
            self._measured = hand_frame(hand)
            self._begins = 2 if stamp - self._seen_at > LONG_GAP_S else max(self._begins - 1, 0)
            self._seen_at = stamp
        self._mean = mean = self._average.mean()
        if left_out:
            self.counts.samples_left_out += 1
            self._reason = f"{hand.name}: {left_out}"
        elif mean is None and not self._average.full:
            self._reason = f"{hand.name}: {self._average.count} of {self._average.size} samples are in"
        elif mean is None:
            self._reason = f"{hand.name} turns too fast"
        else:
            self._update_gate(hand, mean, now)
        if self._average.lost or (self._gate.running and mean is None):
            self._end(f"{hand.name} was lost: {left_out or 'it turns too fast'}", now, keep=True)

    def _update_gate(self, hand: TrackedHand, mean: MeanHand, now: float) -> None:
        ran, resumes = self._gate.running, self._lock.owner is not None
        obstacles = {} if ran else self._obstacles(resumes, now)
        faults = self._gate.step(mean, obstacles, lambda: self._start_fault(mean), resumes)
        self._reason = f"{hand.name}: {'; '.join(faults)}" if faults else f"{hand.name} is followed"
        if ran and faults:
            if self._keeps:
                self._keep(now)
            self._lock.end()
        elif self._gate.running and not ran:
            self._lock.engage()
            self._start(mean, now, resumes)
            self._stays, self._asked, self._out_of_reach = None, now, ""
            self.counts.streams += 1
        elif self._gate.running:
            waits = self._is_relative and self._mode != SERVO
            if waits or (self._is_relative and self._begins > 0 and not self._slow and self._stays is None):
                assert self._newest is not None, (
                    "a stream runs from the frame on in which it brought the tool somewhere"
                )
                self._stays, self._start_tool = None, self._T_base_virtual @ self._newest
                self._start_relative(mean)
                if waits:
                    self._reason = self._obstacle = (
                        f"{hand.name} is followed once the arm is ready; it is in {self._mode}"
                    )
                return
            R_leap_hand = mean.T_leap_hand[:3, :3]
            self._attitude.follow(R_leap_hand if self._relative is None else self._relative.change(R_leap_hand))
            self._stay_while_slow(hand, mean, now)

    def _obstacles(self, resumes: bool, now: float) -> dict[str, str]:
        """Returns the conditions of a start, apart from the hand's own, that are not met, with a sentence each."""
        found, held, switches = {}, self._hold.T_base_tool is not None, self.switches
        if not self._lock.came_in and not resumes:
            found[CAME_IN] = "it was in the box already, or was found there; take it out of the box and back in"
        if switches.clutched or switches.lost:
            found[RELEASED] = switches.lost or switches.stop or ""
        if switches.elsewhere:
            found[CHOSEN] = switches.elsewhere
        if not switches.enabled:
            found[ENABLED] = "the enabling device is not pressed"
        if not held and now - self._tool_at <= self._pause:
            found[READY] = f"the arm still waits for the hand before, {self._pause:g} s after its last frame"
        elif not held and self._is_relative and self._mode != AT_HOME:
            found[READY] = f"the arm is not at home, its controller is in the mode {self._mode or 'unknown'}"
        elif self._is_relative and not self._control_on:
            found[READY] = "control of the arm is off"
        elif self._is_relative and not now - self._status_at <= MAX_STATUS_AGE_S:
            found[READY] = "the arm's controller is silent"
        if self._slow:
            found[RATE] = f"{self._slowness}, and {ENOUGH_RATE_HZ:g} are needed"
        return found

    @property
    def _slowness(self) -> str:
        return f"the tracker delivers only {self._watch.rate or 0.0:.0f} frames per second"

    def _start_fault(self, mean: MeanHand) -> tuple[str, str] | None:
        """Returns the condition and the sentence of what inhibits a start that is allowed otherwise, or None: the arm
        cannot come to where the hand would start, or it is unknown where the tool is. A held tool is there already.
        """
        T_base_held = self._hold.T_base_tool
        if T_base_held is not None:
            self._start_tool = T_base_held
            return None
        if self._is_relative:
            try:
                self._start_tool = unscaled(self._measured_tool(), self._ws_center, self._scale)
            except ValueError as error:
                return READY, f"where the tool is cannot be said: {error}"
            return None
        R_leap_hand, psi = mean.T_leap_hand[:3, :3], heading(mean.T_leap_hand[:3, 0])
        clipped = SteadyAttitude(R_leap_hand, psi, self._limits).clipped
        T_virtual_tool = pose(self._as_at_home(self._level(clipped, psi)), mean.palm)
        reason = self._can_reach(self._virtual_leap(psi) @ T_virtual_tool, True)
        return (REACH, reason) if reason else None

    def _start(self, mean: MeanHand, now: float, resumes: bool) -> None:
        """Starts the stream of the hand: where the tool is held or is, if it is held or the engagement relative.

        A hand that resumes keeps its directions.
        """
        R_leap_hand = mean.T_leap_hand[:3, :3]
        self._turn(self._heading if resumes else heading(R_leap_hand[:, 0]))
        self._taken = self._hold.held is not None and not self._hold.kept
        T_base_held, self._hand_over = self._hold.take(), None
        if self._is_relative:
            self._start_relative(mean)
            return
        self._attitude = SteadyAttitude(R_leap_hand, self._heading, self._limits)
        if T_base_held is not None:
            self._take_over(T_base_held, mean, now)

    def _start_relative(self, mean: MeanHand) -> None:
        """Lets the tool start from `_start_tool`, and the hand from where it is."""
        self._relative = relative_motion(self._start_tool, self._T_base_virtual[:3, :3], mean.T_leap_hand)
        self._T_base_virtual = self._relative.T_base_virtual
        self._attitude = SteadyAttitude(self._relative.change(mean.T_leap_hand[:3, :3]), 0.0, self._limits)

    def _virtual_leap(self, psi: float) -> np.ndarray:
        return virtual_leap_pose(self._mounting, self._ws_center, self.box.center, psi)

    def _turn(self, psi: float) -> None:
        """Turns the virtual Leap so that the heading psi [rad] points forward."""
        self._heading = psi
        self._T_base_virtual = read_only(self._virtual_leap(psi))

    def _take_over(self, T_base_held: np.ndarray, mean: MeanHand, now: float) -> None:
        """Shifts the stream of the hand such that it starts at the held tool."""
        T_virtual_tool = pose(self._level(self._attitude.clipped, self._heading), mean.palm)
        R_virtual_level = self._level(Attitude(0.0, 0.0, 0.0), self._heading)
        if self._R_level_home is not None:
            T_base_held = pose(T_base_held[:3, :3] @ self._R_level_home.T, T_base_held[:3, 3])
        self._hand_over = hand_over(T_base_held, self._T_base_virtual, T_virtual_tool, R_virtual_level, now)
        self._T_base_virtual = self._hand_over.T_base_virtual

    def _stay_while_slow(self, hand: TrackedHand, mean: MeanHand, now: float) -> None:
        """Keeps the tool where it is while the tracker is slow; afterwards only a hand that stayed too steers on."""
        if self._slow:
            self.counts.slow_frames += 1
            self._stays = self._newest if self._stays is None else self._stays
            self._reason = self._obstacle = f"{self._slowness}; the tool stays until {ENOUGH_RATE_HZ:g} come"
        elif self._stays is not None:
            step, self._stays = inverse(self._stays) @ self._tool(mean, now), None
            if np.linalg.norm(step[:3, 3]) > MAX_STEP_M or rotation_angle(step[:3, :3]) > MAX_HELD_TURN:
                self._end(f"{hand.name} moved while the tracker was slow", now, keep=True)

    def _end(self, reason: str, now: float, *, keep: bool) -> None:
        """Ends the stream, if it runs; with `keep` its tool is kept from `now` [s] on, and a hold continues."""
        if not keep:
            self._hold.end(reason)
        elif self._gate.running and self._keeps:
            self._keep(now)
        if self._lock.owner is not None:
            self._lock.end()
        self._average.reset()
        self._gate.stop()
        self._mean, self._measured, self._reason = None, None, reason

    def _tool(self, mean: MeanHand, now: float) -> np.ndarray:
        """Returns T_virtual_tool as the hand of the stream asks for it."""
        if self._relative is not None:
            R_virtual_tool = self._relative.rotation(self._attitude.clipped)
        else:
            R_virtual_tool = self._level(self._attitude.clipped, self._heading)
            if self._hand_over is not None:
                R_virtual_tool = self._hand_over.rotation(R_virtual_tool, now)
            R_virtual_tool = self._as_at_home(R_virtual_tool)
        R_base_virtual, p_base_virtual = self._T_base_virtual[:3, :3], self._T_base_virtual[:3, 3]
        out = self._border.back(R_base_virtual @ mean.palm + p_base_virtual, self._scale)
        self._stopped_by = bool(np.any(out))
        return pose(R_virtual_tool, mean.palm + R_base_virtual.T @ out if self._stopped_by else mean.palm)

    def _level(self, angles: Attitude, heading: float) -> np.ndarray:
        """Returns R_virtual_tool, shape (3, 3), of a tool that points down for a level hand."""
        return tool_rotation(angles, heading, self._mounting.tool_reversed)

    def _as_at_home(self, R_virtual_tool: np.ndarray) -> np.ndarray:
        """Returns it for a tool that is as at home for a level hand."""
        return R_virtual_tool if self._R_level_home is None else R_virtual_tool @ self._R_level_home

    def _result(self, usable: bool, now: float) -> TeleopResult:
        mean = self._mean
        T_virtual_filtered = None if mean is None else mean.T_leap_hand
        hold_end, switches, left = self._hold.end_reason(), self.switches, self._hold.left(now)
        more: dict[str, Any] = {"enabled": switches.enabled, "clutched": switches.clutched, "source": switches.source}
        if not self._gate.running:
            T_held, T_virtual_tool, hold, reason = self._hold.T_base_tool, None, HoldState.NONE, self._reason
            if T_held is not None:
                T_virtual_tool = read_only(inverse(self._T_base_virtual) @ T_held)
                hold = HoldState.KEPT if self._hold.kept else HoldState.HELD
            if hold is HoldState.KEPT:
                reason += f"; the tool stays for {math.ceil(left)} s"
            return TeleopResult(
                StreamState.WAITING,
                hold_end or reason,
                usable,
                self._T_base_virtual,
                self._measured,
                T_virtual_filtered,
                T_virtual_tool,
                hold=hold,
                keep_grip=hold is HoldState.KEPT,
                hold_left=left,
                unmet=self._gate.unmet,
                **more,
            )
        hold = HoldState.TAKEN if self._taken else HoldState.NONE
        if self._newest is not None and now - self._asked >= REACH_PERIOD_S:
            self._asked = now
            self._out_of_reach = self._can_reach(self._T_base_virtual @ self._newest, False) or ""
        if self._out_of_reach and self._obstacle is None:
            self._reason = self._obstacle = f"{self._name} is followed, but {self._out_of_reach}"
        reason, T_virtual_tool, measured, clipped = self._reason, None, None, None
        if mean is not None:
            T_virtual_tool = read_only(self._tool(mean, now)) if self._stays is None else self._stays
            self._newest, measured, clipped = T_virtual_tool, self._attitude.measured, self._attitude.clipped
            limited = self._attitude.limited + ["position"] * self._stopped_by
            more["limits"] = tuple(limited)
            reason += f"; {' and '.join(limited)} at the limit" if limited else ""
        elif self._keeps:  # the arm must not go home before the hold begins
            T_virtual_tool = self._newest
        return TeleopResult(
            state=StreamState.RUNNING,
            reason=reason,
            usable=usable,
            T_base_virtual=self._T_base_virtual,
            T_virtual_hand=self._measured,
            T_virtual_filtered=T_virtual_filtered,
            T_virtual_tool=T_virtual_tool,
            measured=measured,
            clipped=clipped,
            hold=hold,
            owner=self._lock.owner,
            obstacle=self._obstacle,
            keep_grip=self._keeps,
            **more,
        )

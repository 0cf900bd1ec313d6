"""From tracking frames to the desired tool frame of the arm: lock on a hand, filter, start gate, virtual Leap, tool.

One object composes the steps. A stream is one engagement of one hand (common.hand_tracking.HandLock). While that hand
is missing, or the tracker is slower than MIN_RATE_HZ, the stream runs on and the tool stays. Poses are in the frame of
the virtual Leap, which has the same coordinates as the real Leap's frame; `T_base_virtual` is its pose in the robot's
base frame; metres and radians.

While no hand steers, the tool may be held at a pose for a hand that then starts from there (tool_hold.py): as long as
tracking frames come in and control of the arm is on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from common.hand_tracking import MAX_STEP_M, FrameWatch, HandLock
from common.poses import inverse, pose, read_only
from common.rotations import rotation_angle
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.hand_average import NOMINAL_RATE_HZ, HandAverage, MeanHand
from leap_kuka.start_gate import StartGate, interaction_box
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


CanReach = Callable[[np.ndarray, bool], "str | None"]


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
    T_virtual_hand: np.ndarray | None = None  # pose of the averaged hand, if there is one
    T_virtual_tool: np.ndarray | None = None  # pose of the desired tool while the stream runs or the tool is held
    measured: Attitude | None = None  # of the hand relative to the heading of its stream, while that runs
    clipped: Attitude | None = None  # the same with each angle within its limit
    hold: HoldState = HoldState.NONE  # HELD while the tool is held, TAKEN while the hand that took it over steers
    owner: tuple[int, bool] | None = None  # id of the hand that steers, and whether it is a left one
    obstacle: str | None = None  # why the tool does not follow the hand although the stream runs


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


class ArmTeleop:
    """The chain of steps with its state.

    `box` is the interaction box in the Leap frame, `T_tool_flange` the pose of the flange in the tool frame, shape
    (4, 4), and `counts` has the events since the start. `can_reach` returns why the arm cannot come to a desired tool
    frame, shape (4, 4) [m], or None: it is asked last before a stream `starts`, and every REACH_PERIOD_S while it runs.

    Raises:
        ConfigError: the interaction box would reach into the Leap.
    """

    def __init__(self, leap: LeapConfig, arm: ArmPlacement, can_reach: CanReach = lambda T, starts: None) -> None:
        self._can_reach, self._asked, self._out_of_reach = can_reach, 0.0, ""
        self._mounting = arm.mounting_frame
        self._ws_center = arm.ws_center
        self._limits = Attitude(*np.radians([leap.run_tol_yaw, leap.run_tol_pitch, leap.run_tol_roll]).tolist())
        self.box = interaction_box(leap, arm)
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
        self._mean: MeanHand | None = None  # in the newest frame
        self._name = ""  # of the hand that was followed last
        self._slow = False
        self._pause = max(PAUSE_S, arm.time_out) + PAUSE_MARGIN_S
        self._tool_at = -math.inf  # when a desired tool was returned last [s]
        self._newest: np.ndarray | None = None  # T_virtual_tool of the newest frame of the stream
        self._stays: np.ndarray | None = None  # the same while the tool stays because the tracker is slow
        self._obstacle: str | None = None
        self._reason = "no tracking frames come in"
        self._hold = ToolHold(self._mounting.up)
        self._hand_over: HandOver | None = None
        self._turn(0.0)

    def hold(self, T_base_tool: np.ndarray, duration: float, now: float) -> HoldAnswer:
        """Holds the tool at a pose, shape (4, 4) [m], for at most `duration` [s], until a hand takes it over there."""
        inhibit_reason = "a hand is followed" if self._gate.running else self._watch.silence(now)
        answer = self._hold.start(T_base_tool, duration, now, inhibit_reason)
        self.counts.holds += answer.success
        return answer

    def end_hold(self) -> HoldAnswer:
        """Ends the hold; a hand that took the tool over continues."""
        held = self._hold.T_base_tool is not None
        self._hold.end("it was ended")
        return HoldAnswer(True, "The hold has ended." if held else "The tool is not held.")

    def control(self, on: bool) -> None:
        """Sets whether control of the arm is on; switching it off ends a hold.

        Where it is on from the beginning, this program was started anew, perhaps under the operator's hand.
        """
        if on and not self._control_known:
            self._lock.end()
            self._lose("control of the arm was on at the start; take the hand out of the box and back in")
        self._control_known = True
        self._hold.control(on)

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
            self._break(end)
        if arrival.restarted:
            self._lock.forget()
        self._hold.expire(now)
        if not arrival.usable:
            self.counts.frames_refused += 1
            return self._result(False, now)
        self.counts.frames += 1
        rate = self._watch.rate
        self._slow = rate is not None and rate < (ENOUGH_RATE_HZ if self._slow else MIN_RATE_HZ)
        self._obstacle = self._mean = None
        owner = self._lock.owner
        hand = self._lock.update(frame.hands, arrival.stamp)
        if self._gate.running and self._lock.owner is None:
            end = f"{self._name} was lost"
            self._lose(end)
        elif self._lock.changed:
            self._average.reset()
        self.counts.id_changes += self._lock.owner not in (owner, None)
        if hand is not None:
            self._follow(hand, arrival.stamp, now)
        elif self._gate.running:
            self.counts.frames_without_owner += 1
            self._reason = self._obstacle = f"{self._name} is not seen; the tool stays"
        else:
            self._reason = "no hand is seen"
        if ran and end:
            self._reason = end
        result = self._result(True, now)
        self._tool_at = self._tool_at if result.T_virtual_tool is None else now
        return result

    def silence(self, now: float) -> TeleopResult | None:
        """Ends the stream if no usable frame came for MAX_SILENCE_S; returns that result, or None while frames come."""
        silence = self._watch.silence(now)
        if silence is None:
            return None
        self._break(silence)
        return self._result(False, now)

    def _break(self, reason: str) -> None:
        """Ends stream and hold."""
        self._lose(reason)
        self._hold.end(reason)

    def _follow(self, hand: TrackedHand, stamp: float, now: float) -> None:
        """Adds a sample of the followed hand to the mean, and updates the gate."""
        self._name = hand.name
        left_out = self._average.add(hand, stamp)
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
            self._lose(f"{hand.name} was lost: {left_out or 'it turns too fast'}")

    def _update_gate(self, hand: TrackedHand, mean: MeanHand, now: float) -> None:
        ran, obstacle = self._gate.running, None
        if not self._lock.came_in:
            obstacle = "it was in the box already, or was found there; take it out of the box and back in"
        elif self._hold.T_base_tool is None and now - self._tool_at <= self._pause:
            obstacle = f"the arm still waits for the hand before, {self._pause:g} s after its last frame"
        elif self._slow:
            obstacle = f"{self._slowness}, and {ENOUGH_RATE_HZ:g} are needed"
        faults = self._gate.step(mean, obstacle, lambda: self._start_out_of_reach(mean))
        self._reason = f"{hand.name}: {'; '.join(faults)}" if faults else f"{hand.name} is followed"
        if ran and faults:
            self._lock.end()
        elif self._gate.running and not ran:
            self._lock.engage()
            self._turn(heading(mean.T_leap_hand[:3, 0]))
            self._attitude = SteadyAttitude(mean.T_leap_hand[:3, :3], self._heading, self._limits)
            self._take_over(mean, now)
            self._stays, self._asked, self._out_of_reach = None, now, ""
            self.counts.streams += 1
        elif self._gate.running:
            self._attitude.follow(mean.T_leap_hand[:3, :3])
            self._stay_while_slow(hand, mean, now)

    @property
    def _slowness(self) -> str:
        return f"the tracker delivers only {self._watch.rate or 0.0:.0f} frames per second"

    def _start_out_of_reach(self, mean: MeanHand) -> str | None:
        """Returns why the arm cannot come to where the hand would start, or None; a held tool is there already."""
        if self._hold.T_base_tool is not None:
            return None
        R_leap_hand, psi = mean.T_leap_hand[:3, :3], heading(mean.T_leap_hand[:3, 0])
        clipped = SteadyAttitude(R_leap_hand, psi, self._limits).clipped
        T_virtual_tool = pose(tool_rotation(clipped, psi, self._mounting.tool_reversed), mean.palm)
        return self._can_reach(self._virtual_leap(psi) @ T_virtual_tool, True)

    def _virtual_leap(self, psi: float) -> np.ndarray:
        return virtual_leap_pose(self._mounting, self._ws_center, float(self.box.center[1]), psi)

    def _turn(self, psi: float) -> None:
        """Turns the virtual Leap so that the heading psi [rad] points forward."""
        self._heading = psi
        self._T_base_virtual = read_only(self._virtual_leap(psi))

    def _take_over(self, mean: MeanHand, now: float) -> None:
        """Starts the stream of the hand at the held tool, if the tool is held."""
        T_base_held, self._hand_over = self._hold.take(), None
        if T_base_held is None:
            return
        T_virtual_tool = self._tool(mean, now)
        R_virtual_level = tool_rotation(Attitude(0.0, 0.0, 0.0), self._heading, self._mounting.tool_reversed)
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
                self._lose(f"{hand.name} moved while the tracker was slow")

    def _lose(self, reason: str) -> None:
        """Ends the stream, if it runs."""
        if self._lock.owner is not None:
            self._lock.end()
        self._average.reset()
        self._gate.running = False
        self._mean, self._reason = None, reason

    def _tool(self, mean: MeanHand, now: float) -> np.ndarray:
        """Returns T_virtual_tool as the hand of the stream asks for it."""
        T_virtual_tool = pose(
            tool_rotation(self._attitude.clipped, self._heading, self._mounting.tool_reversed), mean.palm
        )
        if self._hand_over is not None:
            T_virtual_tool[:3, :3] = self._hand_over.rotation(T_virtual_tool[:3, :3], now)
        return T_virtual_tool

    def _result(self, usable: bool, now: float) -> TeleopResult:
        mean = self._mean
        T_virtual_hand = None if mean is None else mean.T_leap_hand
        hold_end = self._hold.end_reason()
        if not self._gate.running:
            T_held, T_virtual_tool, hold = self._hold.T_base_tool, None, HoldState.NONE
            if T_held is not None:
                T_virtual_tool, hold = read_only(inverse(self._T_base_virtual) @ T_held), HoldState.HELD
            poses = (self._T_base_virtual, T_virtual_hand, T_virtual_tool)
            return TeleopResult(StreamState.WAITING, hold_end or self._reason, usable, *poses, hold=hold)
        hold = HoldState.NONE if self._hand_over is None else HoldState.TAKEN
        if self._newest is not None and now - self._asked >= REACH_PERIOD_S:
            self._asked = now
            self._out_of_reach = self._can_reach(self._T_base_virtual @ self._newest, False) or ""
        if self._out_of_reach and self._obstacle is None:
            self._reason = self._obstacle = f"{self._name} is followed, but {self._out_of_reach}"
        reason, T_virtual_tool, measured, clipped = self._reason, None, None, None
        if mean is not None:
            T_virtual_tool = read_only(self._tool(mean, now)) if self._stays is None else self._stays
            self._newest, measured, clipped = T_virtual_tool, self._attitude.measured, self._attitude.clipped
            limited = self._attitude.limited
            reason += f"; {' and '.join(limited)} at the limit" if limited else ""
        return TeleopResult(
            state=StreamState.RUNNING,
            reason=reason,
            usable=usable,
            T_base_virtual=self._T_base_virtual,
            T_virtual_hand=T_virtual_hand,
            T_virtual_tool=T_virtual_tool,
            measured=measured,
            clipped=clipped,
            hold=hold,
            owner=self._lock.owner,
            obstacle=self._obstacle,
        )

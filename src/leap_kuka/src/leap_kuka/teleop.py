"""From tracking frames to the desired tool frame of the arm: choice of the hand, mean, start gate, virtual Leap, tool.

One object composes the steps. Poses are in the frame of the virtual Leap, which has the same coordinates as the real
Leap's frame; `T_base_virtual` is its pose in the robot's base frame; metres and radians.

While no hand steers, the tool may be held at a pose for a hand that then starts from there (tool_hold.py): as long as
tracking frames come in and control of the arm is on.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from common.hand_tracking import FrameWatch, HandChoice
from common.poses import inverse, pose, read_only
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.hand_average import HandAverage, MeanHand
from leap_kuka.start_gate import StartGate, interaction_box
from leap_kuka.tool_hold import HandOver, HoldAnswer, HoldState, ToolHold, hand_over
from leap_kuka.virtual_leap import Attitude, attitude, heading, tool_rotation, virtual_leap_pose
from leap_motion.frames import TrackedHand, TrackingFrame

MAX_SILENCE_S = 0.2  # longest time between two tracking frames of one stream


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


@dataclass
class TeleopCounts:
    """Events since the start."""

    frames: int = 0
    frames_refused: int = 0
    samples_left_out: int = 0
    streams: int = 0
    holds: int = 0


class ArmTeleop:
    """The chain of steps with its state.

    `box` is the interaction box in the Leap frame, `T_tool_flange` the pose of the flange in the tool frame, shape
    (4, 4), and `counts` has the events since the start.

    Raises:
        ConfigError: the interaction box would reach into the Leap.
    """

    def __init__(self, leap: LeapConfig, arm: ArmPlacement) -> None:
        self._mounting = arm.mounting_frame
        self._ws_center = arm.ws_center
        self._limits = Attitude(*np.radians([leap.run_tol_yaw, leap.run_tol_pitch, leap.run_tol_roll]).tolist())
        self.box = interaction_box(leap, arm)
        self.T_tool_flange = read_only(inverse(arm.T_flange_tool))
        self.counts = TeleopCounts()
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._choice = HandChoice()
        self._average = HandAverage(leap.buffer_size)
        self._gate = StartGate(leap, self.box)
        self._hand: TrackedHand | None = None
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
        """Sets whether control of the arm is on; switching it off ends a hold."""
        self._hold.control(on)

    def step(self, frame: TrackingFrame, now: float) -> TeleopResult:
        """Processes the newest frame; `now` is its time of arrival on a monotonic clock [s]."""
        ran = self._gate.running
        arrival = self._watch.arrived(frame.id, frame.age, now)
        end = arrival.broken
        if end:
            self._break(end)
        self._hold.expire(now)
        if not arrival.usable:
            self.counts.frames_refused += 1
            return self._result(False, now)
        self.counts.frames += 1
        hand = self._choice.choose(frame.hands)
        if self._hand is not None and (hand is None or (hand.id, hand.is_left) != (self._hand.id, self._hand.is_left)):
            end = f"{self._hand.name} was lost"
            self._lose(end)
        self._hand = hand
        if hand is None:
            self._reason = "no hand is seen"
        else:
            self._add(hand, now)
        if ran and end:
            self._reason = end
        return self._result(True, now)

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

    def _add(self, hand: TrackedHand, now: float) -> None:
        """Adds a sample of the followed hand to the mean, and updates the gate."""
        left_out = self._average.add(hand, now)
        mean = self._average.mean()
        if left_out:
            self.counts.samples_left_out += 1
            self._reason = f"{hand.name}: {left_out}"
        elif mean is None and self._average.count < self._average.size:
            self._reason = f"{hand.name}: {self._average.count} of {self._average.size} samples are in"
        elif mean is None:
            self._reason = f"{hand.name} turns too fast"
        else:
            self._update_gate(hand, mean, now)
        if self._average.lost or (self._gate.running and mean is None):
            self._lose(f"{hand.name} was lost: {left_out or 'it turns too fast'}")

    def _update_gate(self, hand: TrackedHand, mean: MeanHand, now: float) -> None:
        ran = self._gate.running
        faults = self._gate.step(mean)
        self._reason = f"{hand.name}: {'; '.join(faults)}" if faults else f"{hand.name} is followed"
        if self._gate.running and not ran:
            self._turn(heading(mean.T_leap_hand[:3, 0]))
            self._take_over(mean, now)
            self.counts.streams += 1

    def _turn(self, psi: float) -> None:
        """Turns the virtual Leap so that the heading psi [rad] points forward."""
        self._heading = psi
        height = float(self.box.center[1])
        self._T_base_virtual = read_only(virtual_leap_pose(self._mounting, self._ws_center, height, psi))

    def _take_over(self, mean: MeanHand, now: float) -> None:
        """Starts the stream of the hand at the held tool, if the tool is held."""
        T_base_held, self._hand_over = self._hold.take(), None
        if T_base_held is None:
            return
        T_virtual_tool, _, _ = self._tool(mean)
        R_virtual_level = tool_rotation(Attitude(0.0, 0.0, 0.0), self._heading, self._mounting.tool_reversed)
        self._hand_over = hand_over(T_base_held, self._T_base_virtual, T_virtual_tool, R_virtual_level, now)
        self._T_base_virtual = self._hand_over.T_base_virtual

    def _lose(self, reason: str) -> None:
        self._average.reset()
        self._gate.running = False
        self._hand, self._reason = None, reason

    def _tool(self, mean: MeanHand) -> tuple[np.ndarray, Attitude, Attitude]:
        """Returns T_virtual_tool as the hand asks for it without a hold, and its attitude, measured and clipped."""
        measured = attitude(mean.T_leap_hand[:3, :3], self._heading)
        clipped = measured.clipped(self._limits)
        R_virtual_tool = tool_rotation(clipped, self._heading, self._mounting.tool_reversed)
        return pose(R_virtual_tool, mean.palm), measured, clipped

    def _result(self, usable: bool, now: float) -> TeleopResult:
        mean = self._average.mean()
        T_virtual_hand = None if mean is None else mean.T_leap_hand
        hold_end = self._hold.end_reason()
        if mean is None or not self._gate.running:
            T_held, T_virtual_tool, hold = self._hold.T_base_tool, None, HoldState.NONE
            if T_held is not None:
                T_virtual_tool, hold = read_only(inverse(self._T_base_virtual) @ T_held), HoldState.HELD
            poses = (self._T_base_virtual, T_virtual_hand, T_virtual_tool)
            return TeleopResult(StreamState.WAITING, hold_end or self._reason, usable, *poses, hold=hold)
        T_virtual_tool, measured, clipped = self._tool(mean)
        hold = HoldState.NONE
        if self._hand_over is not None:
            T_virtual_tool[:3, :3] = self._hand_over.rotation(T_virtual_tool[:3, :3], now)
            hold = HoldState.TAKEN
        held = [name for name in ("yaw", "pitch", "roll") if getattr(measured, name) != getattr(clipped, name)]
        reason = self._reason + (f"; {' and '.join(held)} at the limit" if held else "")
        poses = (self._T_base_virtual, T_virtual_hand, read_only(T_virtual_tool))
        return TeleopResult(StreamState.RUNNING, reason, usable, *poses, measured, clipped, hold)

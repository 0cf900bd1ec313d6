"""From tracking frames to the desired tool frame of the arm: choice of the hand, mean, start gate, virtual Leap, tool.

One object composes the steps 3 to 6 of the data's way. Poses are in the frame of the virtual Leap, which holds the same
numbers as the real Leap's frame, and `T_base_virtual` places it in the robot's base frame; metres and radians.

While no hand steers, the tool may be held at a pose for a hand that then starts from there (tool_hold.py). It is held
only while tracking frames come in, so that a person can take over, and control of the arm is on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.frame_watch import FrameWatch
from common.hand_choice import HandChoice
from common.poses import inverse, pose, read_only
from leap_kuka.config import ArmConfig, LeapConfig
from leap_kuka.desired_tool import Attitude, attitude, tool_rotation
from leap_kuka.hand_average import HandAverage, MeanHand
from leap_kuka.hand_frame import HandSample
from leap_kuka.start_gate import Box, StartGate, interaction_box
from leap_kuka.tool_hold import HELD, NONE, TAKEN, Answer, HandOver, ToolHold, hand_over
from leap_kuka.virtual_leap import heading, virtual_leap_pose

WAITING = "waiting"
RUNNING = "running"
NO_FRAMES = "no tracking frames come in"

MAX_SILENCE_S = 0.2
"""Longest time between two tracking frames of one stream."""


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
    hands: tuple[HandSample, ...]


@dataclass(frozen=True)
class TeleopResult:
    """What became of a frame.

    Attributes:
        state: RUNNING while the hand steers, else WAITING.
        reason: one sentence: which hand is followed, or what the stream waits for.
        usable: whether the frame was new and of the present; only then its poses are to be published.
        T_base_virtual: pose of the virtual Leap in the base frame, shape (4, 4).
        T_virtual_hand: pose of the averaged hand, shape (4, 4), or None without one.
        T_virtual_tool: pose of the desired tool, shape (4, 4), or None unless the state is RUNNING or the tool is held.
        measured: attitude of the hand against the heading of its stream, or None unless the state is RUNNING.
        clipped: the same with each angle within its limit.
        hold: HELD while the tool is held, TAKEN while the hand steers that took it over, else NONE.
    """

    state: str
    reason: str
    usable: bool
    T_base_virtual: np.ndarray
    T_virtual_hand: np.ndarray | None = None
    T_virtual_tool: np.ndarray | None = None
    measured: Attitude | None = None
    clipped: Attitude | None = None
    hold: str = NONE


@dataclass
class Counts:
    """What happened since the start."""

    frames: int = 0
    frames_refused: int = 0
    samples_left_out: int = 0
    streams: int = 0
    holds: int = 0


class Teleop:
    """The chain of steps with its state.

    Args:
        leap: the parameters of this package.
        arm: what it needs to know of the arm.

    Attributes:
        box: the interaction box in the Leap frame.
        T_tool_flange: pose of the flange in the tool frame, shape (4, 4).
        counts: what happened since the start.

    Raises:
        ConfigError: the interaction box would reach into the Leap.
    """

    def __init__(self, leap: LeapConfig, arm: ArmConfig) -> None:
        self._mounting = arm.mounting_frame
        self._ws_center = arm.ws_center
        self._limits = Attitude(*np.radians([leap.run_tol_yaw, leap.run_tol_pitch, leap.run_tol_roll]).tolist())
        self.box: Box = interaction_box(leap, arm)
        self.T_tool_flange = read_only(inverse(arm.T_flange_tool))
        self.counts = Counts()
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._choice = HandChoice()
        self._average = HandAverage(leap.buffer_size)
        self._gate = StartGate(leap, self.box)
        self._hand: HandSample | None = None
        self._reason = NO_FRAMES
        self._hold = ToolHold(self._mounting.up)
        self._hand_over: HandOver | None = None
        self._turn(0.0)

    def reset(self) -> None:
        """Ends stream and hold and forgets all frames; the virtual Leap stays as the last stream placed it."""
        self._hold.end(NO_FRAMES)
        self._watch.reset()
        self._choice.reset()
        self._lose(NO_FRAMES)

    def hold(self, T_base_tool: np.ndarray, duration: float, now: float) -> Answer:
        """Holds the tool at a pose until a hand takes it over from there; that hand's stream then is as any other.

        Args:
            T_base_tool: shape (4, 4) [m].
            duration: how long it is held without a hand [s].
            now: on the clock of `step` [s].
        """
        hindrance = "a hand is followed" if self._gate.running else self._watch.silence(now)
        answer = self._hold.ask(T_base_tool, duration, now, hindrance)
        self.counts.holds += answer.success
        return answer

    def end_hold(self) -> Answer:
        """Ends the hold; a hand that took the tool over goes on."""
        held = self._hold.T_base_tool is not None
        self._hold.end("it was ended")
        return Answer(True, "The hold has ended." if held else "The tool is not held.")

    def control(self, on: bool) -> None:
        """Tells whether control of the arm is on; a hold ends with it."""
        self._hold.control(on)

    def step(self, frame: TrackingFrame, now: float) -> TeleopResult:
        """Takes a frame in.

        Args:
            frame: the newest frame.
            now: time of its arrival, on a clock that never jumps [s].
        """
        ran = self._gate.running
        arrival = self._watch.arrived(frame.id, frame.age, now)
        end = arrival.broken
        if end:
            self._lose(end)
            self._hold.end(end)
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
            self._take(hand, now)
        if ran and end:
            self._reason = end
        return self._result(True, now)

    def silence(self, now: float) -> TeleopResult | None:
        """Ends the stream if no usable frame came for MAX_SILENCE_S; returns that result, or None while frames come."""
        silence = self._watch.silence(now)
        if silence is None:
            return None
        self._lose(silence)
        self._hold.end(silence)
        return self._result(False, now)

    def _take(self, hand: HandSample, now: float) -> None:
        """Takes a sample of the followed hand into the mean, and lets the gate decide."""
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
            self._decide(hand, mean, now)
        if self._average.lost or (self._gate.running and mean is None):
            self._lose(f"{hand.name} was lost: {left_out or 'it turns too fast'}")

    def _decide(self, hand: HandSample, mean: MeanHand, now: float) -> None:
        ran = self._gate.running
        faults = self._gate.step(mean)
        self._reason = f"{hand.name}: {'; '.join(faults)}" if faults else f"{hand.name} is followed"
        if self._gate.running and not ran:
            self._turn(heading(mean.T_leap_hand[:3, 0]))
            self._take_over(mean, now)
            self.counts.streams += 1

    def _turn(self, psi: float) -> None:
        """Turns the virtual Leap so that the heading psi [rad] points ahead."""
        self._heading = psi
        height = float(self.box.center[1])
        self._T_base_virtual = read_only(virtual_leap_pose(self._mounting, self._ws_center, height, psi))

    def _take_over(self, mean: MeanHand, now: float) -> None:
        """Lets the hand go on from where the tool is held, if it is."""
        T_base_held, self._hand_over = self._hold.take(), None
        if T_base_held is None:
            return
        T_virtual_tool, _, _ = self._tool(mean)
        R_virtual_level = tool_rotation(Attitude(0.0, 0.0, 0.0), self._heading, self._mounting.tool_reversed)
        self._hand_over = hand_over(T_base_held, self._T_base_virtual, T_virtual_tool, R_virtual_level, now)
        self._T_base_virtual = self._hand_over.T_base_virtual

    def _lose(self, reason: str) -> None:
        self._average.reset()
        self._gate.reset()
        self._hand = None
        self._reason = reason

    def _tool(self, mean: MeanHand) -> tuple[np.ndarray, Attitude, Attitude]:
        """Returns the tool that the hand alone asks for, T_virtual_tool, and the hand's attitude, measured and clipped.

        A hold is not thought of here.
        """
        measured = attitude(mean.T_leap_hand[:3, :3], self._heading)
        clipped = measured.clipped(self._limits)
        R_virtual_tool = tool_rotation(clipped, self._heading, self._mounting.tool_reversed)
        return pose(R_virtual_tool, mean.palm), measured, clipped

    def _result(self, usable: bool, now: float) -> TeleopResult:
        mean = self._average.mean()
        T_virtual_hand = None if mean is None else mean.T_leap_hand
        hold_end = self._hold.news()
        if mean is None or not self._gate.running:
            T_base_held = self._hold.T_base_tool
            return TeleopResult(
                WAITING,
                hold_end or self._reason,
                usable,
                self._T_base_virtual,
                T_virtual_hand,
                None if T_base_held is None else read_only(inverse(self._T_base_virtual) @ T_base_held),
                hold=NONE if T_base_held is None else HELD,
            )
        T_virtual_tool, measured, clipped = self._tool(mean)
        if self._hand_over is not None:
            T_virtual_tool[:3, :3] = self._hand_over.rotation(T_virtual_tool[:3, :3], now)
        return TeleopResult(
            RUNNING,
            f"{self._reason}{_at_limit(measured, clipped)}",
            usable,
            self._T_base_virtual,
            T_virtual_hand,
            read_only(T_virtual_tool),
            measured,
            clipped,
            NONE if self._hand_over is None else TAKEN,
        )


def _at_limit(measured: Attitude, clipped: Attitude) -> str:
    """Returns which angles are held at their limits, as the end of a sentence."""
    held = [name for name in ("yaw", "pitch", "roll") if getattr(measured, name) != getattr(clipped, name)]
    return f"; {' and '.join(held)} at the limit" if held else ""

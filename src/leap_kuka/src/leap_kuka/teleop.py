"""From tracking frames to the desired tool frame of the arm: choice of the hand, mean, start gate, virtual Leap, tool.

One object composes the steps 3 to 6 of the data's way. Poses are in the frame of the virtual Leap, which holds the same
numbers as the real Leap's frame, and `T_base_virtual` places it in the robot's base frame; metres and radians.
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
        T_virtual_tool: pose of the desired tool, shape (4, 4), or None unless the state is RUNNING.
        measured: attitude of the hand against the heading of its stream, or None like the tool.
        clipped: the same with each angle within its limit.
    """

    state: str
    reason: str
    usable: bool
    T_base_virtual: np.ndarray
    T_virtual_hand: np.ndarray | None = None
    T_virtual_tool: np.ndarray | None = None
    measured: Attitude | None = None
    clipped: Attitude | None = None


@dataclass
class Counts:
    """What happened since the start."""

    frames: int = 0
    frames_refused: int = 0
    samples_left_out: int = 0
    streams: int = 0


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
        self._bearings = arm.bearings
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
        self._turn(0.0)

    def reset(self) -> None:
        """Ends the stream and forgets all frames; the virtual Leap stays as the last stream turned it."""
        self._watch.reset()
        self._choice.reset()
        self._lose(NO_FRAMES)

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
        if not arrival.usable:
            self.counts.frames_refused += 1
            return self._result(usable=False)
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
        return self._result(usable=True)

    def silence(self, now: float) -> TeleopResult | None:
        """Ends the stream if no usable frame came for MAX_SILENCE_S; returns that result, or None while frames come."""
        silence = self._watch.silence(now)
        if silence is None:
            return None
        self._lose(silence)
        return self._result(usable=False)

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
            self._decide(hand, mean)
        if self._average.lost or (self._gate.running and mean is None):
            self._lose(f"{hand.name} was lost: {left_out or 'it turns too fast'}")

    def _decide(self, hand: HandSample, mean: MeanHand) -> None:
        ran = self._gate.running
        faults = self._gate.step(mean)
        self._reason = f"{hand.name}: {'; '.join(faults)}" if faults else f"{hand.name} is followed"
        if self._gate.running and not ran:
            self._turn(heading(mean.T_leap_hand[:3, 0]))
            self.counts.streams += 1

    def _turn(self, psi: float) -> None:
        """Turns the virtual Leap so that the heading psi [rad] points ahead."""
        self._heading = psi
        height = float(self.box.center[1])
        self._T_base_virtual = read_only(virtual_leap_pose(self._bearings, self._ws_center, height, psi))

    def _lose(self, reason: str) -> None:
        self._average.reset()
        self._gate.reset()
        self._hand = None
        self._reason = reason

    def _result(self, usable: bool) -> TeleopResult:
        mean = self._average.mean()
        T_virtual_hand = None if mean is None else mean.T_leap_hand
        if not self._gate.running:
            return TeleopResult(WAITING, self._reason, usable, self._T_base_virtual, T_virtual_hand)
        measured = attitude(mean.T_leap_hand[:3, :3], self._heading)
        clipped = measured.clipped(self._limits)
        R_virtual_tool = tool_rotation(clipped, self._heading, self._bearings.turned)
        return TeleopResult(
            RUNNING,
            f"{self._reason}{_held(measured, clipped)}",
            usable,
            self._T_base_virtual,
            T_virtual_hand,
            read_only(pose(R_virtual_tool, mean.palm)),
            measured,
            clipped,
        )


def _held(measured: Attitude, clipped: Attitude) -> str:
    """Returns which angles are held at their limits, as the end of a sentence."""
    held = [name for name in ("yaw", "pitch", "roll") if getattr(measured, name) != getattr(clipped, name)]
    return f"; {' and '.join(held)} at the limit" if held else ""

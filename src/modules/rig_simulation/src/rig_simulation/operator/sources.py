"""Sources of frames: no hand, an operator who follows a script, or a recording; and their playback with ids and times.
A source yields (interval, frame): the time since the last frame [s], and a frame that waits for the `id` and
`timestamp` of the service. The service counts hand ids, so a source gets the first free one."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import List, Protocol, Tuple

import numpy as np

from common.errors import RigError
from common.ros.files import text_of
from leap_motion.codec import WHOLE_LIMIT
from leap_motion.service import wire
from leap_motion.service.hand import ReportedHand
from rig_simulation.devices.leap.sensing import FRAME_RATE, Tracker
from rig_simulation.operator import motion
from rig_simulation.operator.hand_model import HandModel, HandPose, fingers_for

PERIOD_S = 1.0 / FRAME_RATE


class RecordingError(RigError):
    """An unusable recording; `path`: of the recording."""

    def __init__(self, path: Path, problem: str) -> None:
        self.path = path
        super().__init__(f"The recording {path} {problem}. Record it again, or choose another file.")


def empty_frames(
    rng: np.random.Generator, service: str, frame_rate: float = FRAME_RATE
) -> Iterator[tuple[float, wire.Frame]]:
    """Yields frames without hands and without end, at the rate of the device [Hz] with its jitter."""
    empty = wire.frame([], frame_rate, service)
    while True:
        yield next_interval(rng, frame_rate), empty


Sensed = Tuple[float, List[ReportedHand], List[int]]
"""Time since the last frame [s], the hands in view, and the order of their fingers."""


def as_frames(
    sensed: Iterator[Sensed], service: str, frame_rate: float = FRAME_RATE
) -> Iterator[tuple[float, wire.Frame]]:
    """Yields the frames of a service, which says that their rate is `frame_rate` [Hz]."""
    for interval, hands, order in sensed:
        yield interval, wire.frame(hands, frame_rate, service, order)


class OperatorHand(Protocol):
    """A hand of an operator, in view or not."""

    def hands(self, rng: np.random.Generator, first_id: int) -> Iterator[Sensed]:
        """Yields what is sensed."""


@dataclass(frozen=True)
class BothHands:
    """An operator with two hands that move by themselves, each as one of `both`: left, right."""

    both: tuple[OperatorHand, OperatorHand]
    service: str = "2.3"
    frame_rate: float = FRAME_RATE  # of both hands [Hz]

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, wire.Frame]]:
        """Yields frames without end, with the hands that are in view."""
        between_ids = 100_000  # between the ids of an operator's two hands
        seeds = rng.integers(2**32, size=len(self.both)).tolist()
        sensed = [
            hand.hands(np.random.default_rng(seed), first_id + number * between_ids)
            for number, (hand, seed) in enumerate(zip(self.both, seeds))
        ]
        return as_frames(self._merged(sensed), self.service, self.frame_rate)

    @staticmethod
    def _merged(sensed: Sequence[Iterator[Sensed]]) -> Iterator[Sensed]:
        for (interval, first, order), (_, second, _) in zip(*sensed):
            yield interval, first + second, order


@dataclass(frozen=True)
class ScriptedOperator:
    """An operator who follows a script."""

    script: motion.Script  # the motions
    side: str = "right"  # of the hand, "right" or "left"
    scale: float = 1.05  # size of the hand against the template
    centre: tuple[float, float, float] = (0.0, 350.0, 0.0)  # of the workspace, in Leap axes [mm]
    service: str = "2.3"  # whose frames
    T_desk_leap: np.ndarray | None = None  # pose of the device where the motions are, shape (4, 4) [mm]
    frame_rate: float = FRAME_RATE  # [Hz]

    @property
    def hand_model(self) -> HandModel:
        return HandModel(self.side, self.scale, self.service == "gemini", self.T_desk_leap)

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, wire.Frame]]:
        """Yields visits without end, each with its own hand id and a pause after it."""
        return as_frames(self.hands(rng, first_id), self.service, self.frame_rate)

    def hands(self, rng: np.random.Generator, first_id: int) -> Iterator[Sensed]:
        model = self.hand_model
        hand_id = first_id
        while True:
            visit = motion.Visit(self.script, rng)
            yield from self._visit(visit, model, hand_id, rng)
            hand_id += 1

    def _visit(self, visit: motion.Visit, model: HandModel, hand_id: int, rng: np.random.Generator) -> Iterator[Sensed]:
        tracker, order = Tracker(model, hand_id, rng, self.frame_rate), rng.permutation(5).tolist()
        t, interval = visit.appears, next_interval(rng, self.frame_rate)
        while t < visit.vanishes + self.script.away:
            hands = []
            if visit.visible(t):
                state, before = visit.state(t), visit.state(t - PERIOD_S)
                speed = float(np.linalg.norm(state[:3] - before[:3])) / PERIOD_S
                pose, curl = self.pose(state), float(state[motion.CURL])
                hands = [tracker.report(pose, curl, speed, t - visit.appears, visit.vanishes - t)]
            yield interval, hands, order
            interval = next_interval(rng, self.frame_rate)
            t += interval

    def pose(self, state: np.ndarray) -> HandPose:
        """Returns the pose of the hand in a state of motion.py, shape (7,)."""
        flexion, spread = fingers_for(state[motion.CURL])
        pitch, yaw, roll = state[[motion.PITCH, motion.YAW, motion.ROLL]]
        mirror = -1.0 if self.side == "left" else 1.0
        palm = np.array(self.centre) + state[:3]
        return HandPose(palm, pitch, mirror * yaw, mirror * roll, flexion, spread)


class Recording:
    """A file of recorded frames, one JSON object a line, as text or compressed by gzip. `rate`: playback speed;
    `offset`: added to every position [mm]; `loop`: whether it repeats, after a pause, with new hand ids. Raises
    RecordingError if the file cannot be read, or a line is not a frame."""

    def __init__(self, path: Path, rate: float = 1.0, offset: Sequence[float] = (0, 0, 0), loop: bool = False) -> None:
        self._rate, self._loop = rate, loop
        self._times: list[int] = []
        self._frames: list[wire.Frame] = []
        for number, line in enumerate(_read(path), 1):
            stamp, frame = self._check(path, number, line, offset)
            self._times.append(stamp)
            self._frames.append(frame)
        if any(b < a for a, b in zip(self._times, self._times[1:])):
            raise RecordingError(path, "has decreasing time stamps")
        self._highest_hand = max(frame.hand_id for frame in self._frames)

    def __len__(self) -> int:
        return len(self._frames)

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, wire.Frame]]:
        """Yields the recorded frames, then empty ones until it repeats, or without end."""
        pause_s = 1.5  # empty frames between two rounds of a recording
        shift = 0 if first_id <= 1 else first_id
        while True:
            interval = PERIOD_S
            for i, frame in enumerate(self._frames):
                if i:
                    interval = (self._times[i] - self._times[i - 1]) * 1e-6 / self._rate
                yield interval, frame.with_ids(shift) if shift else frame
            shift += self._highest_hand + 1
            pause = 0.0
            for interval, empty in empty_frames(rng, "2.3"):
                if self._loop and pause > pause_s:
                    break
                pause += interval
                yield interval, empty

    @staticmethod
    def _check(path: Path, number: int, line: str, offset: Sequence[float]) -> tuple[int, wire.Frame]:
        try:
            frame = json.loads(line)
            numbers = [frame["timestamp"], *(hand["id"] for hand in frame["hands"])]
            if all(isinstance(number, int) and abs(number) <= WHOLE_LIMIT for number in numbers):
                moved = wire.shifted(frame, offset)
                return frame["timestamp"], wire.frame_from(moved if any(offset) else frame)
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            pass
        raise RecordingError(path, f"has no frame of the Leap service in line {number}")


def _read(path: Path) -> list[str]:
    try:
        content = path.read_bytes()
        text = text_of(gzip.decompress(content) if path.suffix.lower() == ".gz" else content)
        lines = [line for line in text.split("\n") if line.strip()]
    except (OSError, EOFError, UnicodeDecodeError, zlib.error) as error:
        raise RecordingError(path, f"cannot be read: {error}") from error
    if not lines:
        raise RecordingError(path, "contains no frames")
    return lines


def next_interval(rng: np.random.Generator, frame_rate: float = FRAME_RATE) -> float:
    """Returns the time to the next frame [s]: the period of the device with its jitter, doubled for a lost frame."""
    jitter_s = 0.08e-3
    lost_frame = 0.005  # probability that the sensor loses a frame: the interval is double, the id continues
    frames = 2 if rng.random() < lost_frame else 1
    return frames / frame_rate + jitter_s * min(max(float(rng.standard_normal()), -3.0), 3.0)


class Source(Protocol):
    """A source of frames: see operator/sources.py."""

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, wire.Frame]]:
        """Yields (interval, frame)."""


@dataclass(frozen=True)
class PlayedFrame:
    """A frame that is due `time` seconds after the service started."""

    time: float
    text: str


class Playback:
    """The clock and counters of the service: frames of the source get rising ids and time stamps. Playing starts the
    source from its beginning; paused, and before, the frames are empty, as those of `service`. The same seed of the
    noise and the same calls give the same frames."""

    def __init__(
        self,
        source: Source,
        seed: int = 0,
        service: str = "2.3",
        playing: bool = True,
        frame_rate: float = FRAME_RATE,  # of the empty frames [Hz]
    ) -> None:
        self._source, self._seed = source, seed
        self._idle = empty_frames(np.random.default_rng(seed), service, frame_rate)
        self._frames = self._idle
        self._time = 0.0
        self._id = 0
        self._next_hand = 1
        self.playing = False
        self.position = 0
        if playing:
            self.play()

    def play(self) -> None:
        """Starts the source from its beginning."""
        self._frames = self._source.frames(np.random.default_rng(self._seed), self._next_hand)
        self.playing, self.position = True, 0

    def pause(self) -> None:
        """Continues with empty frames."""
        self._frames, self.playing = self._idle, False

    def restart(self) -> None:
        """Restarts ids and time, like a restarted service; the source continues."""
        self._time, self._id = 0.0, 0

    def next(self) -> PlayedFrame:
        start_us = 1_000_000
        interval, frame = next(self._frames)
        self._time += interval
        self._id += 1
        self.position += self.playing
        self._next_hand = max(self._next_hand, frame.hand_id + 1)
        return PlayedFrame(self._time, frame.text(self._id, start_us + round(self._time * 1e6)))

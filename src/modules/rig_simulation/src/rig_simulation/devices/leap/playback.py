"""The clock and counters of the service: frames of the source get rising ids and time stamps.

Playing starts the source from its beginning; paused, and before, the frames are empty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rig_simulation.devices.leap import wire
from rig_simulation.operator.sources import empty_frames

START_US = 1_000_000


class Source(Protocol):
    """A source of frames: see operator/sources.py."""

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, dict]]:
        """Yields (interval, frame)."""


@dataclass(frozen=True)
class PlayedFrame:
    """A frame that is due `time` seconds after the service started."""

    time: float
    text: str


class Playback:
    """Plays a source, or empty frames.

    Args:
        source: of the frames.
        seed: of the noise; the same seed and calls give the same frames.
        fields: field set of the empty frames.
        playing: whether it plays from the start.
    """

    def __init__(self, source: Source, seed: int = 0, fields: str = "2.x", playing: bool = True) -> None:
        self._source, self._seed = source, seed
        self._idle = empty_frames(np.random.default_rng(seed), fields)
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
        """Returns the next frame."""
        interval, message = next(self._frames)
        self._time += interval
        self._id += 1
        self.position += self.playing
        for hand in message["hands"]:
            self._next_hand = max(self._next_hand, hand["id"] + 1)
        stamp = START_US + round(self._time * 1e6)
        return PlayedFrame(self._time, wire.text({**message, "id": self._id, "timestamp": stamp}))

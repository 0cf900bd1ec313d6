"""Short sounds on engage, release, limit and stop: which change sounds which, and how it sounds. There is no sound
without a change, and at most one every GAP_S; of changes within that time the most important one sounds afterwards, and
a stop is never left out. A limit sounds at most every LIMIT_GAP_S."""

from __future__ import annotations

import io
import math
import wave
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

GAP_S = 0.35
LIMIT_GAP_S = 2.0
RATE_HZ = 16_000


class Sound(Enum):
    """The sounds."""

    LIMIT = "limit"
    RELEASE = "release"
    ENGAGE = "engage"
    STOP = "stop"


class Beep(Enum):
    """The sounds of an episode."""

    COUNT = "count"
    BEGIN = "begin"
    END = "end"


NOTES: Mapping[Sound | Beep, tuple[tuple[float, float], ...]] = {
    Sound.LIMIT: ((1175.0, 0.06),),
    Sound.RELEASE: ((880.0, 0.09), (587.0, 0.13)),
    Sound.ENGAGE: ((587.0, 0.09), (880.0, 0.13)),
    Sound.STOP: ((330.0, 0.1), (247.0, 0.1), (330.0, 0.1)),
    Beep.COUNT: ((698.0, 0.08),),
    Beep.BEGIN: ((1047.0, 0.25),),
    Beep.END: ((698.0, 0.1), (523.0, 0.15)),
}
"""Pitch [Hz] and length [s], one after the other; shorter than GAP_S together."""


@dataclass(frozen=True)
class Cue:
    """What can be heard to change."""

    engaged: bool  # a hand steers the tool
    limited: bool
    stopped: bool


class Sounds:
    """Chooses the sounds."""

    def __init__(self) -> None:
        self._cue: Cue | None = None
        self._waiting: Sound | None = None
        self._last = self._last_limit = -math.inf

    def step(self, cue: Cue, now: float) -> Sound | None:
        """Takes the state at `now` [s] and returns the sound that begins now, if any; the first state has none."""
        before, self._cue = self._cue or cue, cue
        for sound, happened in (
            (Sound.LIMIT, cue.limited and not before.limited and now - self._last_limit >= LIMIT_GAP_S),
            (Sound.RELEASE if before.engaged else Sound.ENGAGE, cue.engaged != before.engaged),
            (Sound.STOP, cue.stopped and not before.stopped),
        ):
            if happened and self._yields_to(sound):
                self._waiting = sound
        if self._waiting is None or now - self._last < GAP_S:
            return None
        sound, self._waiting, self._last = self._waiting, None, now
        if sound is Sound.LIMIT:
            self._last_limit = now
        return sound

    def _yields_to(self, sound: Sound) -> bool:
        """Whether the waiting sound yields: a stop never, nothing to a limit, an engagement to its release."""
        return self._waiting is not Sound.STOP and (sound is not Sound.LIMIT or self._waiting is None)


def wav(sound: Sound | Beep) -> bytes:
    """Returns a sound as a WAV file: one channel of 16 bits."""
    samples = np.concatenate([_note(*note) for note in NOTES[sound]])
    file = io.BytesIO()
    with wave.open(file, "wb") as out:
        out.setnchannels(1)
        out.setsampwidth(2)
        out.setframerate(RATE_HZ)
        out.writeframes((samples * (2**15 - 1)).astype("<i2").tobytes())
    return file.getvalue()


def _note(pitch: float, length: float) -> np.ndarray:
    """Returns the samples of a note, -1 to 1, that fades in and out so that it does not click."""
    fade_s = 0.01
    loudness = 0.4
    t = np.arange(round(length * RATE_HZ)) / RATE_HZ
    return loudness * np.sin(2.0 * np.pi * pitch * t) * np.clip(np.minimum(t, length - t) / fade_s, 0.0, 1.0)

"""Whether a stream of pictures lives: new ones come, often enough, and they show something new.

Times are handed in as seconds of a monotonic clock; a stamp and a picture's digest are only compared with the ones
before.
"""

from __future__ import annotations

import dataclasses
from collections import deque

from common.config import flag, number

RATE_WINDOW_S = 2.0


@dataclasses.dataclass(frozen=True)
class WatchConfig:
    """The schema of camera_watchdog.yaml."""

    silence: float = number("s", above=0.0, high=10.0, doc="longest time without a new picture")
    min_rate: float = number("Hz", low=0.0, high=60.0, doc="fewer pictures a second are worth a warning; 0 = never")
    min_depth: float = number(low=0.0, high=1.0, doc="smallest share of pixels with a depth; 0 = none")
    pictures: bool = flag(doc="look into the pictures too, as long as somebody else takes them")


@dataclasses.dataclass(frozen=True)
class Health:
    """The state of a stream.

    Attributes:
        state: waiting (none came yet), alive, slow, empty, garbled, frozen or vanished.
        sentence: what is wrong, or that nothing is.
    """

    state: str
    sentence: str

    @property
    def usable(self) -> bool:
        """Whether its pictures may be worked with."""
        return self.state in ("alive", "slow")


class StreamWatch:
    """Judges one stream.

    Args:
        name: in the sentences, such as "colour camera".
        config: limits.
    """

    def __init__(self, name: str, config: WatchConfig) -> None:
        self._name, self._config = name, config
        self._stamp: float | None = None
        self._digest: int | None = None
        self._last: float | None = None
        self._new_stamp: float | None = None
        self._new_digest: float | None = None
        self._filled = 1.0
        self._garbled, self._garbage = float("-inf"), ""
        self._times: deque[float] = deque()

    def arrived(self, stamp: float, now: float) -> None:
        """Takes a message with the stamp of a picture in.

        Args:
            stamp: of the picture [s].
            now: time of arrival [s].
        """
        self._last = now
        if stamp != self._stamp:
            self._stamp, self._new_stamp = stamp, now
            self._times.append(now)

    def looked(self, digest: int, now: float, filled: float = 1.0) -> None:
        """Takes in what a picture shows.

        Args:
            digest: a number that hardly ever is the same for two different pictures.
            now: time of arrival [s].
            filled: share of pixels with a depth.
        """
        if digest != self._digest:
            self._digest, self._new_digest = digest, now
        self._filled = filled

    def looked_in_vain(self, reason: str, now: float) -> None:
        """Takes in that a picture is garbled.

        Args:
            reason: a clause.
            now: time of arrival [s].
        """
        self._garbage, self._garbled = reason, now

    def look_away(self) -> None:
        """Forgets what pictures showed: nobody takes them any more."""
        self._digest = self._new_digest = None
        self._garbled = float("-inf")
        self._filled = 1.0

    def rate(self, now: float) -> float:
        """Returns new pictures per second over the last RATE_WINDOW_S [Hz]; 0 with fewer than two."""
        while self._times and self._times[0] < now - RATE_WINDOW_S:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / (self._times[-1] - self._times[0])

    def health(self, now: float) -> Health:
        """Returns the state at the time `now` [s]."""
        limit = self._config.silence
        if self._last is None or self._new_stamp is None:
            return Health("waiting", f"The {self._name} has sent nothing yet.")
        if now - self._last > limit:
            return Health("vanished", f"The {self._name} vanished: nothing for {now - self._last:.1f} s.")
        if now - self._new_stamp > limit:
            return Health("frozen", f"The {self._name} is frozen: the same stamp for {now - self._new_stamp:.1f} s.")
        if now - self._garbled <= limit:
            return Health("garbled", f"The {self._name} sends garbled pictures: {self._garbage}.")
        if self._filled < self._config.min_depth:
            return Health(
                "empty", f"The {self._name} sees nothing: {100.0 * self._filled:.0f} % of the pixels are valid."
            )
        if self._new_digest is not None and now - self._new_digest > limit:
            return Health("frozen", f"The {self._name} is frozen: the same picture for {now - self._new_digest:.1f} s.")
        rate = self.rate(now)
        if 0.0 < rate < self._config.min_rate:
            return Health("slow", f"The {self._name} is slow: {rate:.1f} pictures a second.")
        return Health("alive", f"The {self._name} sends pictures.")

"""Monitors a stream of images: new ones have to arrive, often enough, and with new content. Times are passed in as
seconds of a monotonic clock. Stamps and image digests are only compared with the previous ones."""

from __future__ import annotations

import dataclasses
from collections import deque

from common.config import flag, number


@dataclasses.dataclass(frozen=True)
class WatchConfig:
    """The schema of camera_watchdog.yaml."""

    silence: float = number("s", above=0.0, high=10.0, doc="maximum time without a new image")
    min_rate: float = number("Hz", low=0.0, high=60.0, doc="a lower rate causes a warning; 0 = never")
    min_depth: float = number(low=0.0, high=1.0, doc="minimum fraction of pixels with a depth; 0 = none")
    pictures: bool = flag(doc="also check the image content, while another node subscribes to the images")


@dataclasses.dataclass(frozen=True)
class StreamHealth:
    """The state of a stream."""

    state: str  # waiting (none arrived yet), alive, slow, empty, garbled, frozen or vanished
    sentence: str  # the problem and its cure, or that there is none

    @property
    def usable(self) -> bool:
        return self.state in ("alive", "slow")


class StreamWatch:
    """Monitors one stream; `name` stands in the sentences, such as "colour camera"."""

    def __init__(self, name: str, config: WatchConfig) -> None:
        self._name, self._config = name, config
        self._stamp: float | None = None
        self._digest: int | None = None
        self._last: float | None = None
        self._new_stamp: float | None = None
        self._new_digest: float | None = None
        self._image: float | None = None  # when the last one came, or they were subscribed to; None: they are not
        self._filled = 1.0
        self._garbled, self._garbage = float("-inf"), ""
        self._times: deque[float] = deque()

    def add_stamp(self, stamp: float, now: float) -> None:
        """Records a message with the image stamp `stamp` that arrived at the time `now` [s]."""
        self._last = now
        if stamp != self._stamp:
            self._stamp, self._new_stamp = stamp, now
            self._times.append(now)

    def add_content(self, digest: int, now: float, filled: float = 1.0) -> None:
        """Records an image's checksum and fraction of pixels with a depth; it arrived at the time `now` [s]."""
        if digest != self._digest:
            self._digest, self._new_digest = digest, now
        self._filled, self._image = filled, now

    def add_garbled(self, reason: str, now: float) -> None:
        """Records a garbled image that arrived at the time `now` [s]; the reason is a clause."""
        self._garbage, self._garbled, self._image = reason, now, now

    def expect_content(self, now: float) -> None:
        """Records that the images were subscribed to at the time `now` [s]; the first one may take twice as long."""
        self._image = now + self._config.silence

    def forget_content(self) -> None:
        """Forgets the image content: the stream's images are not received any more."""
        self._digest = self._new_digest = self._image = None
        self._garbled = float("-inf")
        self._filled = 1.0

    def rate(self, now: float) -> float:
        """Returns new images per second over the last 2 s [Hz]; 0 with fewer than two."""
        rate_window_s = 2.0
        while self._times and self._times[0] < now - rate_window_s:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / (self._times[-1] - self._times[0])

    def health(self, now: float) -> StreamHealth:
        """Returns the state at the time `now` [s]."""
        limit, name = self._config.silence, f"The {self._name}"
        if self._last is None or self._new_stamp is None:
            return StreamHealth("waiting", f"{name} has sent nothing yet: is its driver running?")
        silent, old = now - self._last, now - self._new_stamp
        if silent > limit:
            return StreamHealth("vanished", f"{name} vanished: nothing for {silent:.1f} s. Check its cable and driver.")
        if old > limit:
            return StreamHealth("frozen", f"{name} is frozen: the same stamp for {old:.1f} s. Restart its driver.")
        if self._image is not None and now - self._image > limit:
            lost = f"{name} sends its camera_info, but no image for {now - self._image:.1f} s"
            return StreamHealth("vanished", f"{lost}. Restart its driver.")
        if now - self._garbled <= limit:
            return StreamHealth("garbled", f"{name} sends garbled images: {self._garbage}.")
        if self._filled < self._config.min_depth:
            valid = f"{100.0 * self._filled:.0f} % of the pixels are valid"
            return StreamHealth("empty", f"{name} measures nothing: {valid}. Clear its view.")
        same = 0.0 if self._new_digest is None else now - self._new_digest
        if same > limit:
            return StreamHealth("frozen", f"{name} is frozen: the same image for {same:.1f} s. Restart its driver.")
        rate = self.rate(now)
        if 0.0 < rate < self._config.min_rate:
            return StreamHealth("slow", f"{name} is slow: {rate:.1f} images per second. Use another USB port.")
        return StreamHealth("alive", f"{name} sends images.")

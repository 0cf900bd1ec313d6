"""Whether the stream of tracking frames is alive and fast enough, and which of the hands in view is the operator's.
Times are seconds of a monotonic clock; only `age`, arrival less the frame's stamp, uses the clock of the stamps. The
time of a frame's stamp is its arrival less its age."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from common.frame_rate import FrameRate
from common.numbers import STAMP_SKEW_S

LEFT = "left"  # which of the operator's hands: one side, or ANY
RIGHT = "right"
ANY = "any"
RATE_WINDOW_S = 0.5  # time over which the frame rate is measured [s]

MAX_STEP_M = 0.02  # farthest that a palm moves between two frames; the largest true step in recordings was 15 mm
MAX_SPEED_M_S = 2.0  # fastest palm
LONG_GAP_S = 0.1  # after a longer gap only a slow hand is the same: nobody saw where it was
LONG_GAP_SPEED_M_S = 0.3  # as at the start of a stream


@dataclass(frozen=True)
class FrameArrival:
    """The verdict on a frame."""

    usable: bool  # whether it is new and of the present; otherwise it must be ignored
    broken: str | None = None  # why it must not continue the stream before it
    restarted: bool = False  # whether the tracker has begun to count anew
    stamp: float = 0.0  # time of its stamp, never before that of the frame before [s]; of a usable frame only


class FrameWatch:
    """Judges each frame by its number, its age and the time since the frame before; the stream is broken after more
    than `max_silence` [s] without a usable frame."""

    def __init__(self, max_silence: float) -> None:
        self._max_silence = max_silence
        self._last_id: int | None = None
        self._last_time: float | None = None
        self._rate = FrameRate(RATE_WINDOW_S)
        self._refusal: tuple[str, float] | None = None

    def arrived(self, frame_id: int, age: float, now: float) -> FrameArrival:
        """Judges a frame that arrived at `now` [s], `age` [s] after its stamp. A repeated number means that the tracker
        hangs, a large age that the clocks differ, or that one was set while the frame was on its way: it is ignored,
        and the silence continues. A lower number means that the tracker has restarted."""
        if not abs(age) <= STAMP_SKEW_S:
            skewed = f"the stamps of the tracking frames are {abs(age):.1f} s {'old' if age > 0 else 'in the future'}"
            self._refusal = (skewed, now)
            return FrameArrival(False)
        if frame_id == self._last_id:
            self._refusal = (f"the tracker repeats frame {frame_id}", now)
            return FrameArrival(False)
        broken, restarted = None, self._last_id is not None and frame_id < self._last_id
        if restarted:
            broken = f"the tracker's frame number went back from {self._last_id} to {frame_id}"
        elif self._last_time is not None and now - self._last_time > self._max_silence:
            broken = f"no tracking frame came for {now - self._last_time:.1f} s"
        self._last_id, self._last_time = frame_id, now
        if broken:
            self._rate.clear()
        # Age and arrival are read one after the other, so the stamps jitter by what a busy processor does between them.
        last = self._rate.last
        stamp = now - age if last is None else max(now - age, last)
        self._rate.take(stamp)
        return FrameArrival(True, broken, restarted, stamp)

    @property
    def rate(self) -> float | None:
        """Usable frames per second by their stamps, over RATE_WINDOW_S at least [Hz]; None while there are too few."""
        return self._rate.value

    def silence(self, now: float) -> str | None:
        """Returns why no usable frame came for longer than `max_silence`, or None where one came."""
        if self._last_time is not None and now - self._last_time <= self._max_silence:
            return None
        if self._refusal is not None and now - self._refusal[1] <= self._max_silence:
            return self._refusal[0]
        return "no tracking frames come in"


class TrackerHand(Protocol):
    """A hand of a frame: the tracker's number of it, its side, and its pose in the Leap frame."""

    @property
    def id(self) -> int: ...
    @property
    def is_left(self) -> bool: ...
    @property
    def palm(self) -> np.ndarray: ...  # shape (3,) [m]
    @property
    def direction(self) -> np.ndarray: ...  # unit vector, shape (3,)
    @property
    def normal(self) -> np.ndarray: ...  # unit vector, shape (3,)


Hand = TypeVar("Hand", bound=TrackerHand)


def of_side(hands: Iterable[Hand], side: str) -> tuple[Hand, ...]:
    """Returns the hands of a side: LEFT, RIGHT or ANY."""
    return tuple(hand for hand in hands if side == ANY or hand.is_left is (side == LEFT))


def plausible_step(elapsed: float) -> float:
    """Returns how far a palm may have moved within `elapsed` [s] to be the same one [m]."""
    return max(MAX_STEP_M, (MAX_SPEED_M_S if elapsed <= LONG_GAP_S else LONG_GAP_SPEED_M_S) * elapsed)


MAX_SUCCESSOR_STEP_M = 0.07  # less than the width of a palm: two hands side by side are never taken for one
MAX_SUCCESSOR_TURN = math.radians(20.0)  # a hand that is found anew differs by some 10 deg, and turns meanwhile
LEFT_BOX_M = 0.02  # a palm is out of the box when it is so far from it,
REMEMBERED_S = 2.0  # a hand that came into the box has done so, though no frame shows it for this long [s]
LEFT_BOX_FRAMES = 3  # in so many frames in a row: neither noise at the edge nor an outlier leaves the box


def succeeds(hand: TrackerHand, before: TrackerHand, elapsed: float) -> bool:
    """Returns whether a hand with a new id is the one that was seen `elapsed` [s] ago: same side, near, same pose."""
    cosine = math.cos(MAX_SUCCESSOR_TURN)
    return (
        hand.is_left == before.is_left
        and float(np.linalg.norm(hand.palm - before.palm)) <= min(plausible_step(elapsed), MAX_SUCCESSOR_STEP_M)
        and float(hand.direction @ before.direction) >= cosine
        and float(hand.normal @ before.normal) >= cosine
    )


@dataclass(eq=False)
class _Track(Generic[Hand]):
    """A hand over its changes of id."""

    hand: Hand  # as it was seen last
    seen: float  # time of that frame's stamp [s]
    came_in: bool  # whether it may start an engagement
    visible: bool = True  # in the newest frame
    candidate_at: float = -math.inf  # when it was last the hand that would be next [s]
    frames_outside: int = 0  # newest frames in a row in which it was out of the box

    @property
    def key(self) -> tuple[int, bool]:
        return self.hand.id, self.hand.is_left


class HandLock(Generic[Hand]):
    """One engagement, one owner: the hand that is locked by `engage`, until `end` or its loss.

    The owner is known by id and side. When the tracker gives it a new id, it stays the owner if side, place,
    orientation and time fit. Once `max_gap` [s] have passed without it, the engagement has ended; no other hand takes
    its place.

    The first engagement takes any hand. Each later one takes only a hand that came in after the end of the one before:
    into the box from outside of it, or, without a box, into view. `outside` returns how far a palm, shape (3,) [m], is
    outside of the box [m].

    `hand` is the owner, or without one the hand that would be next: one that may start, in the box, seen longest. That
    one keeps its turn while it is in view and at most LEFT_BOX_M outside; after `turn` [s] without an engagement it
    yields to another one that may start in the box, so that a hand that cannot start blocks nobody. `hand` is None
    where that hand is not in the newest frame. `changed` tells that it is another one than in the frame before.
    The visible time that the tracker reports is unreliable (early Leap services put the service's uptime there), so the
    order of appearance is kept here."""

    def __init__(
        self, max_gap: float, outside: Callable[[np.ndarray], float] | None = None, turn: float = math.inf
    ) -> None:
        self._max_gap = max_gap
        self._outside = outside
        self._turn = turn
        self._turn_began = 0.0
        self._tracks: list[_Track[Hand]] = []  # in the order of appearance
        self._followed: _Track[Hand] | None = None
        self._any_hand = True  # before the first end
        self.engaged = self.changed = False
        self.hand: Hand | None = None

    @property
    def came_in(self) -> bool:
        return self._followed is not None and self._followed.came_in

    @property
    def owner(self) -> tuple[int, bool] | None:
        """Id of the owner, and whether it is a left hand; None without an engagement."""
        return self._followed.key if self.engaged and self._followed is not None else None

    def engage(self) -> None:
        self.engaged = self._followed is not None

    def end(self) -> None:
        """Ends the engagement; every hand in view must go out and come in again."""
        self.engaged = self._any_hand = False
        for track in self._tracks:
            track.came_in, track.frames_outside = False, 0

    def forget(self) -> None:
        """Forgets all hands: the tracker has restarted, and its numbers mean others."""
        self._tracks.clear()

    def update(self, hands: Iterable[Hand], now: float) -> Hand | None:
        """Updates the choice from the hands of a frame whose stamp is at `now` [s]; returns `hand`."""
        before = self._followed
        keep = self._max_gap if self._outside is None else REMEMBERED_S
        self._tracks = [track for track in self._tracks if now - track.seen <= keep]
        if self.engaged and (before is None or now - before.seen > self._max_gap):
            self.end()
        self._match(hands, now)
        if not self.engaged:
            self._followed = self._next([track for track in self._tracks if track.visible], now)
        self.changed = self._followed is not before
        if self.changed:
            self._turn_began = now
        self.hand = self._followed.hand if self._followed is not None and self._followed.visible else None
        return self.hand

    def _next(self, visible: list[_Track[Hand]], now: float) -> _Track[Hand] | None:
        """Returns the hand that would be next, of those in view, in the order of appearance."""
        kept = self._followed
        if kept is None or kept not in visible or not kept.came_in or self._outside_m(kept) > LEFT_BOX_M:
            return min(visible, key=self._rank) if visible else None
        kept.candidate_at = now
        others = [t for t in visible if t is not kept and t.came_in and self._outside_m(t) <= 0.0]
        if not others or now - self._turn_began < self._turn:
            return kept
        return min(others, key=lambda track: track.candidate_at)

    def _match(self, hands: Iterable[Hand], now: float) -> None:
        """Assigns the hands of a frame to the tracks by id and side, the rest by what they may be successors of."""
        for known_track in self._tracks:
            known_track.visible = False
        known = {track.key: track for track in self._tracks}
        visible = {(hand.id, hand.is_left): hand for hand in hands}
        for key in sorted(visible, key=lambda key: (key not in known, key)):
            hand, track = visible[key], known.get(key)
            if track is None:
                gone = [t for t in self._tracks if t.key not in visible and now - t.seen <= self._max_gap]
                track = next((t for t in gone if succeeds(hand, t.hand, now - t.seen)), None)
            if track is None:
                track = _Track(hand, now, self._any_hand or self._outside is None)
                self._tracks.append(track)
            track.hand, track.seen, track.visible = hand, now, True
            out = self._outside is not None and self._outside(hand.palm) > LEFT_BOX_M
            track.frames_outside = track.frames_outside + 1 if out else 0
            track.came_in |= track.frames_outside >= LEFT_BOX_FRAMES

    def _outside_m(self, track: _Track[Hand]) -> float:
        """Returns how far the hand is outside of the box [m]."""
        return -math.inf if self._outside is None else self._outside(track.hand.palm)

    def _rank(self, track: _Track[Hand]) -> tuple[bool, bool]:
        inside = self._outside_m(track) <= 0.0
        return not (inside and track.came_in), not inside

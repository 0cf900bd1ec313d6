"""Frames of the Leap service from a page's messages, one for each frame of the headset. A message has the page's
clock `t` [ms], the number `place` of its request for a new placement, `head`, and `left` and `right`: 75 numbers, or
null for a hand that is not seen. A hand that is missing or implausible is no hand; one that jumps is another hand,
with a new number. Late messages, and more than 200 a second, are ignored."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from leap_motion.headset.placement import FROM_XR, Placement, placement, xr_hand
from leap_motion.numbers import SETTLE_S
from leap_motion.service.hand import ReportedHand, hand_from_joints

LATE_S = 0.1  # a message that is later than the fastest ones is ignored
JUMP_M = 0.03  # a palm that moved farther than this and JUMP_M_S allow is another hand
JUMP_M_S = 4.0
PINCH_S = 1.0  # both hands pinched for so long place the box anew


@dataclass(frozen=True)
class HandFrame:
    """What a message says: the hands in Leap axes, when [s of our clock], and how often such frames come [Hz]."""

    hands: tuple[ReportedHand, ...]
    time: float
    rate: float


class HandStream:
    """Makes frames of messages. The box is placed `ahead` of the head and `below` it [m] at the first message, when
    the page or both hands ask for it, and when its height above the Leap changes. `note` is a sentence for the
    person, or empty; `placement` is None before the first."""

    def __init__(self, ahead: float, below: float) -> None:
        self._ahead = ahead
        self._below = below
        self.note = ""
        self.placement: Placement | None = None
        self._placed_for: object = None
        self._hands: dict[str, ReportedHand] = {}
        self._seen: dict[str, float] = {}  # when each of the hands came [s]
        self._number = 0
        self._settled = -math.inf
        self.interrupt()

    def restart(self) -> None:
        """Forgets everything: the next message is of another headset, in a room of its own."""
        self.interrupt()
        self.placement, self._placed_for = None, None

    def interrupt(self) -> None:
        """Forgets hands and clock: what comes next is new."""
        self._hands.clear()
        self._offset: float | None = None
        self._last, self._rate = -math.inf, 0.0
        self._heard = 0.0  # when the newest message came [s]
        self._pinched: float | None = None

    def step(self, message: dict, now: float, height: float, steers: bool) -> HandFrame | None:
        """Returns the frame of a message that came at `now` [s], or None if it is ignored. The box is `height` above
        the Leap [m]; while a hand `steers`, pinching does not place it anew. Raises ValueError for a message of
        another form."""
        pinch = 0.8
        sent: Any = message.get("t")
        place, head = message.get("place"), message.get("head")
        if not (_number(sent) and type(place) is int and isinstance(head, list) and len(head) == 7):
            raise ValueError("A message of the page lacks the time, the head or the number of the placement.")
        if not all(map(_number, head)):
            raise ValueError("The head of a message of the page is not seven numbers.")
        time = self._time(1e-3 * sent, now)
        if time is None:
            return None
        if (place, height) != self._placed_for:
            self._place(head, height, now)
            self._placed_for = (place, height) if self.placement else None
        hands = {side: xr_hand(message.get(side)) for side in ("left", "right")}
        self._hands = {} if self.placement is None else self._reported(hands, self.placement, time)
        pinched = len(self._hands) == 2 and all(hand.pinch >= pinch for hand in self._hands.values())
        if steers or not pinched:
            self._pinched = None
        elif self._pinched is None:
            self._pinched = now
        elif now - self._pinched >= PINCH_S:
            self._place(head, height, now)
        if self.placement is None or now < self._settled:
            self._hands = {}
        else:
            self.note = "" if self._hands else "No hand is seen: hold one before you."
        return HandFrame(tuple(self._hands.values()), time, self._rate)

    def _time(self, sent: float, now: float) -> float | None:
        """Returns when a message left, in our time as if the fastest one had come at once; None if it is ignored."""
        max_rate_hz = 200.0
        clock_drift = 1e-3  # how much faster than ours the page's clock may run
        drift = clock_drift * max(now - self._heard, 0.0)
        self._heard = now
        self._offset = now - sent if self._offset is None else min(now - sent, self._offset + drift)
        time = sent + self._offset
        elapsed = time - self._last
        if now - time > LATE_S:
            self.note = "The hands come late: the network is slow."
        if now - time > LATE_S or elapsed < 1.0 / max_rate_hz:
            return None
        self._rate = (
            0.0 if math.isinf(elapsed) else 1.0 / elapsed if not self._rate else 0.9 * self._rate + 0.1 / elapsed
        )
        self._last = time
        return time

    def _place(self, head: list, height: float, now: float) -> None:
        """Places the box, or says why not; either way the hands of before are no more."""
        self._settled, self._pinched = now + SETTLE_S, None
        try:
            self.placement, self.note = placement(np.array(head), self._ahead, self._below, height), ""
        except ValueError as error:
            self.placement, self.note = None, str(error)

    def _reported(self, hands: dict[str, np.ndarray | None], placed: Placement, time: float) -> dict[str, ReportedHand]:
        found = {}
        for side, points in hands.items():
            if points is None:
                continue
            points = placed.to_leap(points)
            before = self._hands.get(side)
            try:
                hand = self._hand(side, points, before, time)
                if before is not None and _jumped(before, hand):
                    hand = self._hand(side, points, None, time)
            except ValueError:  # no hand looks like this
                continue
            found[side] = hand
        return found

    def _hand(self, side: str, points: np.ndarray, before: ReportedHand | None, time: float) -> ReportedHand:
        number, since = (self._number + 1, time) if before is None else (before.id, self._seen[side])
        hand = hand_from_joints(number, side, points[FROM_XR], points[0], time - since, before=before)
        self._number, self._seen[side] = max(number, self._number), since
        return hand


def _jumped(before: ReportedHand, hand: ReportedHand) -> bool:
    farthest = max(JUMP_M, JUMP_M_S * (hand.time_visible - before.time_visible))
    return bool(1e-3 * np.linalg.norm(hand.palm - before.palm) > farthest)


def _number(value: Any) -> bool:
    largest = 1e15  # numbers beyond this are not measurements
    return type(value) in (int, float) and abs(value) < largest  # NaN is not below it

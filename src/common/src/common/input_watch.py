"""What is first wrong with the inputs of a node that turns them into outputs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

OUTPUT_S = 1.0  # a node whose newest output is older does not work
KEPT_S = 2.0  # a reason is kept for so long when the inputs stop


class InputWatch:
    """Takes what a node sees of its inputs, each known by its name (its topic), and says what is first wrong. `streams`
    have to keep coming, of `once` the first message is enough. `slop` [s]: what comes out needs one of each of the
    first two streams, with stamps that differ no more. `silent` [s]: a stream is silent without a message for so long.
    All times are monotonic [s], all reasons clauses."""

    def __init__(
        self, streams: Iterable[str], once: Iterable[str] = (), slop: float | None = None, silent: float = OUTPUT_S
    ) -> None:
        self._streams = tuple(streams)
        self._once = tuple(once)
        self._slop = slop
        self._silent = silent
        self._once_came: set[str] = set()
        self.restart()

    def restart(self) -> None:
        """Forgets the streams and the output, as when a node subscribes anew."""
        stamps = 32  # of each input that are compared with those of its partner
        self._came: dict[str, float] = {}
        self._stamps: dict[str, deque[float]] = {name: deque(maxlen=stamps) for name in self._streams}
        self._nearest: tuple[float, float] | None = None  # smallest difference of two stamps [s], and when it was seen
        self._refused = "", -math.inf  # the newest reason since the last output, and when it came
        self._output: float | None = None

    def came(self, name: str, now: float, stamp: float = 0.0) -> None:
        """Takes that a message came, with its stamp [s]."""
        near_s = 0.95  # the nearest stamps count for so long; less than OUTPUT_S
        beside_s = 0.5  # stamps of messages that came within so long are compared
        if name in self._once:
            self._once_came.add(name)
            return
        self._came[name] = now
        if self._slop is None or name not in self._streams[:2]:
            return
        self._stamps[name].append(stamp)
        partner = self._streams[1 - self._streams.index(name)]
        if self._stamps[partner] and now - self._came.get(partner, -math.inf) <= beside_s:
            difference = min(abs(stamp - other) for other in tuple(self._stamps[partner]))
            if self._nearest is None or difference <= self._nearest[0] or now - self._nearest[1] > near_s:
                self._nearest = difference, now

    def refused(self, reason: str, now: float) -> None:
        self._refused = reason, now

    def done(self, now: float) -> None:
        self._refused, self._output = ("", now), now

    def missing(self, now: float, silent: float | None = None) -> str:
        """Returns which inputs do not come, empty if all do; `silent` instead of that of this watch."""
        return self._never() or self._silence(now, self._silent if silent is None else silent)

    def fault(self, now: float) -> str:
        """Returns why nothing has come out for OUTPUT_S, empty if something has."""
        if self._output is not None and now - self._output <= OUTPUT_S:
            return ""
        why, at = self._refused
        reason = self._apart() or (why if now - at <= KEPT_S else "")
        return (
            self._never()
            or self._silence(now, max(self._silent, KEPT_S) if reason else self._silent)
            or reason
            or self._silence(now, OUTPUT_S)
            or self._stalled(now)
        )

    def _never(self) -> str:
        never = [name for name in self._streams if name not in self._came]
        never += [name for name in self._once if name not in self._once_came]
        return f"nothing has come on {', '.join(never)}" if never else ""

    def _silence(self, now: float, limit: float) -> str:
        ages = {name: now - self._came.get(name, now) for name in self._streams}
        silent = {name: age for name, age in ages.items() if age > limit}
        return f"nothing has come on {', '.join(silent)} for {min(silent.values()):.1f} s" if silent else ""

    def _apart(self) -> str:
        if self._slop is None or self._nearest is None or self._nearest[0] <= self._slop:
            return ""
        first, second = self._streams[:2]
        without = [name for name in (first, second) if self._stamps[name] and self._stamps[name][-1] == 0.0]
        if without:
            return f"the messages on {', '.join(without)} have no stamp"
        nearest = f"the nearest stamps on {first} and {second} are {self._nearest[0]:.3f} s apart"
        return f"{nearest}, but at most {self._slop:g} s are allowed (slop)"

    def _stalled(self, now: float) -> str:
        if self._output is None:
            return "the inputs have come, but nothing has come out of them yet"
        return f"the inputs come, but nothing has come out of them for {now - self._output:.1f} s"

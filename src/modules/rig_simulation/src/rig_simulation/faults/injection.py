"""Fault injection: the faults that a simulated device knows, which of them are on, and for how long.

All devices share one convention. On the control port, `{"do": "fault", "name": "slow", "value": 0.3, "duration": 2}`
switches a fault on, `"on": false` switches it off, and `{"do": "faults"}` lists all. On the command line it is
`--fault NAME[:SECONDS[:VALUE]]`; the camera node has the same texts in a parameter. A fault without a duration stays on
until it is switched off. The device asks which faults are on and acts on them.
"""

from __future__ import annotations

import argparse
import functools
import math
import random
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Optional, Tuple, TypeVar

from common import clock
from common.command_line import finite, positive
from common.config import is_number
from common.errors import ConfigError


@dataclass(frozen=True)
class FaultValue:
    """The number of a fault: its meaning with its unit, its default, and its range; `whole` for a count or index."""

    doc: str
    default: float
    low: float
    high: float
    whole: bool = False


Option = Tuple[str, Optional[float], Optional[float]]
"""A fault from the start: its name, its duration [s] or None, its value or None."""


def fraction_of(what: str) -> FaultValue:
    return FaultValue(f"fraction of the {what}", 1.0, 0.01, 1.0)


@dataclass(frozen=True)
class Fault:
    """One fault of a device: its name, its effect on the wire, and its number if it has one."""

    name: str
    doc: str
    value: FaultValue | None = None


@dataclass(frozen=True)
class _Active:
    value: float
    ends: float


class Faults:
    """The faults of one device. Any thread may switch and ask. `now`: monotonic [s]."""

    def __init__(self, known: Sequence[Fault], now: Callable[[], float] | None = None) -> None:
        self._known = {fault.name: fault for fault in known}
        self._now = now or clock.monotonic
        self._active: dict[str, _Active] = {}
        self._values: dict[str, float] = {}  # of the active faults; replaced, never changed
        self._next_end = math.inf  # of an active fault [s]
        self._reported: dict[str, float] = {}
        self._lock = clock.Lock()

    def switch(
        self, name: str, on: bool = True, value: float | None = None, duration: float | None = None
    ) -> dict[str, list[str]]:
        """Switches a fault (one that is on gets the new value and duration) and returns the names of all that are on
        now, under "active". `value`: its number, None takes the default; `duration`: time until it switches itself off
        [s], None: never. Raises ValueError for an unknown fault or a number out of range."""
        fault = find(self._known.values(), name)
        if not isinstance(on, bool):
            raise ValueError(f"The field on is {on!r}, but must be true or false.")
        number = _check_value(fault, value)
        if duration is not None and not (is_number(duration) and duration > 0.0):
            raise ValueError(f"The duration is {duration!r}, but must be a number of seconds above 0.")
        ends = math.inf if duration is None else self._now() + duration
        with self._lock:
            self._active.pop(name, None)
            if on:
                self._active[name] = _Active(number, ends)
            self._update(self._now())
        return {"active": sorted(self.active())}

    def active(self) -> dict[str, float]:
        """Returns the faults that are on, each with its number, 1.0 for a fault without one; not to be changed."""
        if self._next_end < math.inf and self._now() >= self._next_end:
            with self._lock:
                self._update(self._now())
        return self._values

    def _update(self, now: float) -> None:
        self._active = {name: active for name, active in self._active.items() if active.ends > now}
        self._values = {name: active.value for name, active in self._active.items()}
        self._next_end = min((active.ends for active in self._active.values()), default=math.inf)

    def is_on(self, name: str) -> bool:
        return self.value(name) is not None

    def value(self, name: str) -> float | None:
        """Returns the number of a fault that is on, 1.0 for a fault without one; None for a fault that is off."""
        if name not in self._known:
            find(self._known.values(), name)  # refuses it
        return self.active().get(name)

    def changes(self) -> dict[str, float | None]:
        """Returns the faults that began, changed their number or ended since the last call, as `value` does."""
        active, before = self.active(), self._reported
        self._reported = active
        begun = {name: value for name, value in active.items() if before.get(name) != value}
        return {**begun, **{name: None for name in before if name not in active}}

    def describe(self) -> dict[str, list[dict]]:
        """Returns all faults under "faults": name, doc, meaning of the value, whether on, value, time left [s]."""
        self.active()
        now = self._now()
        with self._lock:
            pairs = [(fault, self._active.get(name)) for name, fault in self._known.items()]
        described = [
            {
                "name": fault.name,
                "doc": fault.doc,
                "value_doc": fault.value.doc if fault.value else None,
                "on": active is not None,
                "value": active.value if active and fault.value else None,
                "left": active.ends - now if active and math.isfinite(active.ends) else None,
            }
            for fault, active in pairs
        ]
        return {"faults": described}

    @property
    def requests(self) -> dict[str, Callable[..., dict]]:
        return {"fault": self.switch, "faults": self.describe}


def find(known: Collection[Fault], name: str) -> Fault:
    """Returns the fault of that name; raises ValueError if the device has no such fault."""
    fault = next((fault for fault in known if fault.name == name), None)
    if fault is None:
        names = ", ".join(sorted(fault.name for fault in known))
        raise ValueError(f"Unknown fault {name!r}; this device has {names}.")
    return fault


def add_option(parser: argparse.ArgumentParser, known: Sequence[Fault], flag: str = "--fault") -> None:
    """Adds the option to a command line; its value is a list of what `switch_all` takes."""
    parser.add_argument(
        flag,
        type=functools.partial(_read, known=known),
        action="append",
        default=[],
        metavar="NAME[:SECONDS[:VALUE]]",
        help=f"a fault from the start, repeatable; without SECONDS it stays on: {', '.join(f.name for f in known)}",
    )


def parameter(text: str, known: Sequence[Fault], name: str) -> list[Option]:
    """Returns the faults in the value of the parameter `name`, written as on a command line and separated by blanks;
    raises ConfigError for an unknown fault, or a number that is invalid or out of range."""
    try:
        return [_read(item, known) for item in text.split()]
    except argparse.ArgumentTypeError as error:
        raise ConfigError([f"{name} is {text!r}: {str(error).rstrip('.')}."]) from None


def switch_all(faults: Faults, options: Iterable[Option]) -> None:
    """Switches on the faults of the command line; durations count from now."""
    for name, duration, value in options:
        faults.switch(name, value=value, duration=duration)


def _read(text: str, known: Sequence[Fault]) -> Option:
    name, *numbers = text.split(":")
    if len(numbers) > 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME[:SECONDS[:VALUE]]")
    seconds, number = [*numbers, "", ""][:2]
    duration, value = positive(seconds) if seconds else None, finite(number) if number else None
    try:
        _check_value(find(known, name), value)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return name, duration, value


def _check_value(fault: Fault, value: float | None) -> float:
    if fault.value is None:
        if value is not None:
            raise ValueError(f"The fault {fault.name!r} takes no value, but got {value!r}.")
        return 1.0
    if value is None:
        return fault.value.default
    inside = is_number(value) and fault.value.low <= value <= fault.value.high
    if not inside or (fault.value.whole and value != int(value)):
        meaning = f"{fault.value.doc}, {fault.value.low:g} to {fault.value.high:g}"
        raise ValueError(f"The value of the fault {fault.name!r} is {value!r}, but must be: {meaning}.")
    return float(value)


Message = TypeVar("Message")


class DelayLine(Generic[Message]):
    """A queue with a due time for each message; no message overtakes another, as in one cable. Time is handed in."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[float, Message]] = deque()

    def put(self, message: Message, due: float) -> None:
        """Takes a message that is due at a time [s], or as soon as those before it have left."""
        self._waiting.append((max(due, self._waiting[-1][0] if self._waiting else -math.inf), message))

    def take(self, now: float) -> list[Message]:
        """Returns the messages that are due by the time `now` [s]."""
        due = []
        while self.next_due() <= now:
            due.append(self._waiting.popleft()[1])
        return due

    def next_due(self) -> float:
        """Returns when the next message is due [s]; infinity for an empty queue."""
        return self._waiting[0][0] if self._waiting else math.inf

    def clear(self) -> None:
        self._waiting.clear()


def garbled(data: bytes, rng: random.Random) -> bytes:
    """Returns the same number of bytes, each of them changed."""
    return bytes((byte + rng.randrange(1, 256)) % 256 for byte in data)

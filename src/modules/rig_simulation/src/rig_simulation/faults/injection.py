"""Faults on demand: which ones a simulated device has, which are on, and for how long.

One convention for all devices. On the control port: `{"do": "fault", "name": "slow", "value": 0.3, "duration": 2}`
switches a fault on, `"on": false` off again; `{"do": "faults"}` lists all of them. On the command line:
`--fault NAME[:SECONDS[:VALUE]]`; the camera, a node, has the same texts in a parameter. A fault without a duration
lasts until it is switched off. What a fault does is up to the device, which asks here; this file knows neither wires
nor devices.
"""

from __future__ import annotations

import argparse
import functools
import math
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Optional, Tuple

from common.errors import ConfigError
from rig_simulation.command_line import finite, positive


@dataclass(frozen=True)
class FaultValue:
    """The number of a fault.

    Attributes:
        doc: what it says, with its unit.
        default: taken where none is given.
        low, high: its range.
        whole: whether it counts something.
    """

    doc: str
    default: float
    low: float
    high: float
    whole: bool = False


Option = Tuple[str, Optional[float], Optional[float]]
"""A fault from the start: its name, after how long it ends [s] or None, its number or None."""


def fraction_of(what: str) -> FaultValue:
    """Returns the number of a fault that meets only some of the messages."""
    return FaultValue(f"share of the {what}", 1.0, 0.01, 1.0)


@dataclass(frozen=True)
class Fault:
    """One fault of a device: its name, what happens on the wire, and its number if it has one."""

    name: str
    doc: str
    value: FaultValue | None = None


@dataclass(frozen=True)
class _Active:
    value: float
    ends: float


class Faults:
    """The faults of one device. Any thread may switch and ask.

    Args:
        known: all faults of the device.
        clock: returns the time in seconds; monotonic.
    """

    def __init__(self, known: Sequence[Fault], clock: Callable[[], float] = time.monotonic) -> None:
        self._known = {fault.name: fault for fault in known}
        self._clock = clock
        self._active: dict[str, _Active] = {}
        self._seen: dict[str, float] = {}
        self._lock = threading.Lock()

    def switch(
        self, name: str, on: bool = True, value: float | None = None, duration: float | None = None
    ) -> dict[str, list[str]]:
        """Switches a fault; one that is on already gets the new value and duration.

        Args:
            name: of the fault.
            on: False ends it.
            value: its number; None takes the default.
            duration: after which it ends by itself [s]; None = when it is switched off.

        Returns:
            The names of all faults that are on now, under "active".

        Raises:
            ValueError: there is no such fault, or a number is out of range.
        """
        fault = self._find(name)
        if not isinstance(on, bool):
            raise ValueError(f"The field on must be true or false, not {on!r}.")
        number = _check_value(fault, value)
        ends = math.inf if duration is None else self._clock() + _check_duration(duration)
        with self._lock:
            if on:
                self._active[name] = _Active(number, ends)
            else:
                self._active.pop(name, None)
        return {"active": sorted(self.active())}

    def active(self) -> dict[str, float]:
        """Returns the faults that are on, each with its number, 1.0 for one that has none."""
        now = self._clock()
        with self._lock:
            self._active = {name: active for name, active in self._active.items() if active.ends > now}
            return {name: active.value for name, active in self._active.items()}

    def is_on(self, name: str) -> bool:
        """Returns whether a fault is on."""
        return self.value(name) is not None

    def value(self, name: str) -> float | None:
        """Returns the number of a fault that is on, 1.0 if it has none; None for one that is off."""
        self._find(name)
        return self.active().get(name)

    def changes(self) -> dict[str, float | None]:
        """Returns what began (or changed its number) and what ended since the last call, as `value` does."""
        active, before = self.active(), self._seen
        self._seen = active
        begun = {name: value for name, value in active.items() if before.get(name) != value}
        return {**begun, **{name: None for name in before if name not in active}}

    def describe(self) -> dict[str, list[dict]]:
        """Returns all faults under "faults": name, doc, what the value says, whether on, its value, time left [s]."""
        self.active()
        now, listed = self._clock(), []
        with self._lock:
            for name, fault in self._known.items():
                active = self._active.get(name)
                left = active.ends - now if active else math.inf
                listed.append(
                    {
                        "name": name,
                        "doc": fault.doc,
                        "value_doc": fault.value.doc if fault.value else None,
                        "on": active is not None,
                        "value": active.value if active and fault.value else None,
                        "left": left if math.isfinite(left) else None,
                    }
                )
        return {"faults": listed}

    @property
    def requests(self) -> dict[str, Callable[..., dict]]:
        """The requests of the control port."""
        return {"fault": self.switch, "faults": self.describe}

    def _find(self, name: str) -> Fault:
        return find(self._known.values(), name)


def find(known: Iterable[Fault], name: str) -> Fault:
    """Returns the fault of that name.

    Raises:
        ValueError: there is none; the sentence lists those that there are.
    """
    faults = {fault.name: fault for fault in known}
    if name not in faults:
        raise ValueError(f"The fault {name!r} is not known here; known are {', '.join(sorted(faults))}.")
    return faults[name]


def add_option(parser: argparse.ArgumentParser, known: Sequence[Fault], flag: str = "--fault") -> None:
    """Adds the option to a command line; its value is a list of what `switch_all` takes."""

    names = ", ".join(fault.name for fault in known)
    parser.add_argument(
        flag,
        type=functools.partial(_read, known=known),
        action="append",
        default=[],
        metavar="NAME[:SECONDS[:VALUE]]",
        help=f"a fault from the start, for so long or for ever; several may be given; known: {names}",
    )


def parameter(text: str, known: Sequence[Fault], name: str) -> list[Option]:
    """Returns the faults that a parameter holds, written as on a command line and parted by blanks.

    Args:
        text: its value.
        known: faults of the device.
        name: of the parameter, for the sentence.

    Raises:
        ConfigError: the device has no such fault, or a number is none or out of range.
    """
    try:
        return [_read(item, known) for item in text.split()]
    except argparse.ArgumentTypeError as error:
        raise ConfigError([f"{name} is {text!r}: {str(error).rstrip('.')}."]) from None


def switch_all(faults: Faults, options: Iterable[Option]) -> None:
    """Switches on what the command line names; the durations count from now."""
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
            raise ValueError(f"The fault {fault.name!r} has no value, but {value!r} was given.")
        return 1.0
    if value is None:
        return fault.value.default
    inside = _is_number(value) and fault.value.low <= value <= fault.value.high
    if not inside or (fault.value.whole and value != int(value)):
        allowed = f"{fault.value.low:g} to {fault.value.high:g}"
        raise ValueError(f"The value of the fault {fault.name!r} is {fault.value.doc}, {allowed}, not {value!r}.")
    return float(value)


def _check_duration(duration: float) -> float:
    if not _is_number(duration) or duration <= 0.0:
        raise ValueError(f"The duration must be a number of seconds above 0, not {duration!r}.")
    return float(duration)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)

"""Typed configuration: a frozen dataclass is the schema of one yaml mapping.

Each field says its type, unit and range; `parse` reports every fault at once, each as one sentence that names the key,
the value and what is allowed. A missing key is a fault, and so is an unknown one: defaults live in the yaml alone.

    @dataclass(frozen=True)
    class TeleopConfig:
        time_out: float = number("s", above=0.0, doc="go home after so long without a new transform")

        def faults(self):                       # optional: what no single field can check
            return []

        @staticmethod
        def faults_among(read):                 # optional: the same, of the fields that are right while others are not
            return []

A field made with `absent` may be missing, which means that value: it came later than the files that people have, or
it is a node's private parameter, for which there is no file.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, Optional, Protocol, TypeVar

import numpy as np

from common.errors import ConfigError

Schema = TypeVar("Schema")
Bound = Optional[float]
"""An end of a range; None: there is none."""

REQUIRED = object()
"""A key that must be there."""


def number(
    unit: str = "",
    *,
    low: Bound = None,
    high: Bound = None,
    above: Bound = None,
    below: Bound = None,
    doc: str = "",
    absent: Any = REQUIRED,
) -> Any:
    """A finite number. `low` and `high` belong to the range, `above` and `below` do not."""
    return _field(_Number(unit, low, high, above, below), doc, absent)


def integer(unit: str = "", *, low: Bound = None, high: Bound = None, doc: str = "", absent: Any = REQUIRED) -> Any:
    """A whole number within [low, high]."""
    return _field(_Integer(unit, low, high, None, None), doc, absent)


def vector(
    length: int,
    unit: str = "",
    *,
    low: Bound = None,
    high: Bound = None,
    above: Bound = None,
    below: Bound = None,
    doc: str = "",
    absent: Any = REQUIRED,
) -> Any:
    """A list of `length` finite numbers, each in the range; becomes a read-only array, shape (length,)."""
    return _field(_Vector(length, _Number(unit, low, high, above, below)), doc, absent)


def flag(doc: str = "", absent: Any = REQUIRED) -> Any:
    """true or false."""
    return _field(_Flag(), doc, absent)


def text(doc: str = "", absent: Any = REQUIRED, empty: bool = False) -> Any:
    """A string that is not empty, unless it may be."""
    return _field(_Text(empty), doc, absent)


def path(doc: str = "", absent: Any = REQUIRED) -> Any:
    """The absolute path of a file, or an empty string for none."""
    return _field(_Path(), doc, absent)


def choice(*options: str, doc: str = "", absent: Any = REQUIRED) -> Any:
    """One of the given strings."""
    return _field(_Choice(options), doc, absent)


def parse(schema: type[Schema], values: Mapping[str, Any], prefix: str = "", others: Iterable[str] = ()) -> Schema:
    """Returns the configuration that `values` describe.

    Args:
        schema: a frozen dataclass whose fields were made by the functions above.
        values: what the yaml or the parameter server holds.
        prefix: stands before each key in the messages, such as "kuka/".
        others: keys that may stand beside the schema's own and belong to somebody else.

    Raises:
        ConfigError: with all faults.
    """
    if not isinstance(values, Mapping):
        raise ConfigError([f"{prefix or 'the configuration'} is {values!r}, but must be a mapping of keys to values."])
    fields = {f.name: f for f in dataclasses.fields(schema)}  # type: ignore[arg-type]  # a TypeVar cannot say "a dataclass"
    faults = [
        f"{prefix}{key} is not a known key; known are {', '.join(fields)}."
        for key in values
        if key not in fields and key not in others
    ]
    read = {}
    for name, field in fields.items():
        if name not in values and field.metadata["absent"] is not REQUIRED:
            read[name] = field.metadata["absent"]
            continue
        if name not in values:
            faults.append(f"{prefix}{name} is missing; it must be {field.metadata['kind'].allowed()}.")
            continue
        try:
            read[name] = field.metadata["kind"].read(values[name])
        except ValueError:
            faults.append(f"{prefix}{name} is {values[name]!r}, but must be {field.metadata['kind'].allowed()}.")
    if not faults:
        config = schema(**read)
        faults = [f"{prefix}{fault}" for fault in getattr(config, "faults", list)()]
        if not faults:
            return config
    else:
        among: list[str] = getattr(schema, "faults_among", lambda read: [])(read)
        faults += [f"{prefix}{fault}" for fault in among]
    raise ConfigError(faults)


def parse_part(
    schema: type[Schema], values: Mapping[str, Any], prefix: str, faults: list[str], others: Iterable[str] = ()
) -> Schema | None:
    """Returns one part of a file as `parse` does, or None after adding what is wrong with it to `faults`."""
    try:
        return parse(schema, values, prefix, others)
    except ConfigError as error:
        faults += error.faults
        return None


class Key(NamedTuple):
    """One key of a schema, for tables: its type in a word, its range and unit where it has them, its meaning, and the
    value that stands for a missing key, REQUIRED where it must be there."""

    name: str
    type: str
    range: str
    unit: str
    meaning: str
    absent: Any


def keys(schema: type) -> list[Key]:
    """Returns the keys of the schema in their order."""
    columns = ((f, f.metadata["kind"].columns()) for f in dataclasses.fields(schema))
    return [
        Key(f.name, kind, interval, unit, f.metadata["doc"], f.metadata["absent"])
        for f, (kind, interval, unit) in columns
    ]


def required(schema: type) -> tuple[str, ...]:
    """Returns the keys without which there is no configuration."""
    return tuple(f.name for f in dataclasses.fields(schema) if f.metadata["absent"] is REQUIRED)


def _field(kind: _Kind, doc: str, absent: Any = REQUIRED) -> Any:
    """Returns the field; `absent` is the value that a missing key stands for, and may be None."""
    absent = absent if absent is REQUIRED or absent is None else kind.read(absent)
    return dataclasses.field(metadata={"kind": kind, "doc": doc, "absent": absent})


class _Kind(Protocol):
    """What a key may hold."""

    def read(self, value: Any) -> Any:
        """Returns the value; raises ValueError where it is not allowed."""

    def allowed(self) -> str:
        """Returns what is allowed, as a part of a sentence."""

    def columns(self) -> tuple[str, str, str]:
        """Returns type, range and unit."""


@dataclasses.dataclass(frozen=True)
class _Number:
    unit: str
    low: float | None
    high: float | None
    above: float | None
    below: float | None

    def read(self, value: Any) -> Any:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ValueError
        if (
            (self.low is not None and value < self.low)
            or (self.high is not None and value > self.high)
            or (self.above is not None and value <= self.above)
            or (self.below is not None and value >= self.below)
        ):
            raise ValueError
        return float(value)

    def allowed(self) -> str:
        return f"a finite number{self._range()}{self._unit()}"

    def columns(self) -> tuple[str, str, str]:
        return "number", self._interval(), self.unit

    def _unit(self) -> str:
        return f" {self.unit}" if self.unit else ""

    def _range(self) -> str:
        interval = self._interval()
        return f" in {interval}" if interval else ""

    def _interval(self) -> str:
        if self.low is None and self.high is None and self.above is None and self.below is None:
            return ""
        left = f"[{self.low:g}" if self.low is not None else f"({self.above:g}" if self.above is not None else "(-inf"
        right = f"{self.high:g}]" if self.high is not None else f"{self.below:g})" if self.below is not None else "inf)"
        return f"{left}, {right}"


class _Integer(_Number):
    def read(self, value: Any) -> Any:
        if not isinstance(value, int):
            raise ValueError
        return int(super().read(value))

    def allowed(self) -> str:
        return f"a whole number{self._range()}{self._unit()}"

    def columns(self) -> tuple[str, str, str]:
        return "whole number", self._interval(), self.unit


@dataclasses.dataclass(frozen=True)
class _Vector:
    length: int
    item: _Number

    def read(self, value: Any) -> Any:
        if isinstance(value, str) or not hasattr(value, "__len__") or len(value) != self.length:
            raise ValueError
        array = np.array([self.item.read(v) for v in value])
        array.setflags(write=False)
        return array

    def allowed(self) -> str:
        interval = self.item._range()
        return f"{self.length} finite numbers{', each' + interval if interval else ''}{self.item._unit()}"

    def columns(self) -> tuple[str, str, str]:
        return f"{self.length} numbers", self.item._interval(), self.item.unit


class _Flag:
    def read(self, value: Any) -> Any:
        if not isinstance(value, bool):
            raise ValueError
        return value

    def allowed(self) -> str:
        return "true or false"

    def columns(self) -> tuple[str, str, str]:
        return "true or false", "", ""


@dataclasses.dataclass(frozen=True)
class _Text:
    empty: bool

    def read(self, value: Any) -> Any:
        if not isinstance(value, str) or not (self.empty or value.strip()):
            raise ValueError
        return value

    def allowed(self) -> str:
        return "a string" if self.empty else "a string that is not empty"

    def columns(self) -> tuple[str, str, str]:
        return "text, or empty" if self.empty else "text", "", ""


class _Path:
    def read(self, value: Any) -> Any:
        if not isinstance(value, str) or (value and not value.startswith("/")):
            raise ValueError
        return value

    def allowed(self) -> str:
        return "an absolute path, or empty"

    def columns(self) -> tuple[str, str, str]:
        return "absolute path, or empty", "", ""


@dataclasses.dataclass(frozen=True)
class _Choice:
    options: tuple[str, ...]

    def read(self, value: Any) -> Any:
        if value not in self.options:
            raise ValueError
        return value

    def allowed(self) -> str:
        return f"one of {', '.join(self.options)}"

    def columns(self) -> tuple[str, str, str]:
        return "one of", ", ".join(self.options), ""

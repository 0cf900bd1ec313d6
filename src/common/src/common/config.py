"""Typed configuration: a frozen dataclass is the schema of one yaml mapping.

Each field states its type, unit and range. `parse` reports every fault at once, each as one sentence that names the
key, the value and what is allowed. A missing key is a fault, and so is an unknown one: defaults live in the yaml alone.

    @dataclass(frozen=True)
    class TeleopConfig:
        time_out: float = number("s", above=0.0, doc="go home after this long without a new transform")

        def faults(self):                       # optional: what no single field can check
            return []

        @staticmethod
        def faults_among(read):                 # optional: the same, of the valid fields while others are not valid
            return []

A field with `absent` may be missing and then has that value: the key is newer than the files that people have, or it is
a private parameter of a node, for which there is no file."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable, Mapping
from typing import Any, Callable, NamedTuple, TypeVar

import numpy as np

from common.errors import ConfigError

Schema = TypeVar("Schema")
LARGEST = sys.float_info.max
QUOTE_IT = "without quotes yaml reads it as another type: quote it, as '007'"
REQUIRED = object()  # stands for the value of a key that must be given


class WrittenMapping(dict):
    """A mapping with the `texts` of those of its scalars, and of those of its lists, that are known as they were
    written: a name such as 007, on, null or 2001-01-01, which yaml reads as another type."""

    def __init__(self, values: Any = (), texts: Mapping[str, Any] | None = None) -> None:
        super().__init__(values)
        self.texts = texts or {}


def as_written(values: Mapping[str, Any], key: str) -> Any:
    """Returns the text of a key as it was written, a list of texts for a list; its value where that is not known."""
    return getattr(values, "texts", {}).get(key, values[key])


def is_number(value: Any) -> bool:
    """Returns whether a value is a finite number that a float can hold."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST


def number(unit: str = "", *, doc: str = "", absent: Any = REQUIRED, **bounds: float) -> Any:
    """A finite number within `bounds`: `low` and `high` belong to the range, `above` and `below` do not."""
    limits = _Range(**bounds)
    return _field(_Kind(limits.number, f"a finite number{limits.within}", "number", str(limits), unit), doc, absent)


def integer(unit: str = "", *, doc: str = "", absent: Any = REQUIRED, **bounds: float) -> Any:
    """A whole number within `bounds`, as of `number`."""
    limits = _Range(**bounds)

    def read(value: Any) -> int:
        return int(limits.number(_instance(value, int)))

    return _field(_Kind(read, f"a whole number{limits.within}", "whole number", str(limits), unit), doc, absent)


def vector(length: int, unit: str = "", *, doc: str = "", absent: Any = REQUIRED, **bounds: float) -> Any:
    """A list of `length` finite numbers, each within `bounds` as of `number`; becomes a read-only array."""
    limits = _Range(**bounds)

    def read(value: Any) -> np.ndarray:
        if not isinstance(value, (list, tuple, np.ndarray)) or len(value) != length:
            raise ValueError
        array = np.array([limits.number(item) for item in value])
        array.setflags(write=False)
        return array

    each = f", each{limits.within}" if limits.within else ""
    return _field(_Kind(read, f"{length} finite numbers{each}", f"{length} numbers", str(limits), unit), doc, absent)


def flag(doc: str = "", absent: Any = REQUIRED) -> Any:
    return _field(_Kind(lambda value: _instance(value, bool), "true or false", "true or false"), doc, absent)


def text(doc: str = "", absent: Any = REQUIRED, empty: bool = False, taken_as: Callable[[str], str] = str) -> Any:
    """A string, which is not empty unless `empty`; `taken_as` makes another of it."""

    def read(value: Any) -> str:
        taken = taken_as(_instance(value, str))
        if not (taken.strip() or empty):
            raise ValueError
        return taken

    kind = ("a string", "text, or empty") if empty else ("a string that is not empty", "text")
    return _field(_Kind(read, *kind, is_text=True), doc, absent)


def path(doc: str = "", absent: Any = REQUIRED) -> Any:
    """The absolute path of a file, or an empty string for none."""

    def read(value: Any) -> str:
        if _instance(value, str) and not value.startswith("/"):
            raise ValueError
        return value

    return _field(_Kind(read, "an absolute path, or empty", "absolute path, or empty"), doc, absent)


def names(doc: str = "", absent: Any = REQUIRED) -> Any:
    """A list of strings that are not empty; becomes a tuple."""

    def read(value: Any) -> tuple[str, ...]:
        if not isinstance(value, (list, tuple)) or not all(isinstance(name, str) and name.strip() for name in value):
            raise ValueError
        return tuple(value)

    return _field(_Kind(read, "a list of names, such as [table]", "list of names", is_text=True), doc, absent)


def choice(*options: str, doc: str = "", absent: Any = REQUIRED) -> Any:
    def read(value: Any) -> str:
        if value not in options:
            raise ValueError
        return value

    names = ", ".join(options)
    return _field(_Kind(read, f"one of {names}", "one of", names), doc, absent)


def parse(schema: type[Schema], values: Mapping[str, Any], prefix: str = "", others: Iterable[str] = ()) -> Schema:
    """Returns the configuration that `values`, of the yaml file or the parameter server, describe; raises ConfigError
    with all faults.
    The fields of `schema`, a frozen dataclass, were made by the functions above; `prefix`, such as "kuka/", precedes
    each key in the messages; the keys `others`, of another owner, may stand beside the schema's own."""
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
        kind: _Kind = field.metadata["kind"]
        if name in values:
            value = as_written(values, name) if kind.is_text else values[name]
            try:
                read[name] = kind.read(value)
            except ValueError:
                faults.append(f"{prefix}{name} is {value!r}, but must be {kind.allowed_with_unit}{kind.cure(value)}.")
        elif field.metadata["absent"] is REQUIRED:
            faults.append(f"{prefix}{name} is missing; it must be {kind.allowed_with_unit}.")
        else:
            read[name] = field.metadata["absent"]
    if faults:
        among: list[str] = getattr(schema, "faults_among", lambda read: [])(read)
        raise ConfigError(faults + [f"{prefix}{fault}" for fault in among])
    config = schema(**read)
    faults = [f"{prefix}{fault}" for fault in getattr(config, "faults", list)()]
    if faults:
        raise ConfigError(faults)
    return config


def parse_part(
    schema: type[Schema], values: Mapping[str, Any], prefix: str, faults: list[str], others: Iterable[str] = ()
) -> Schema | None:
    """Returns one part of a file as `parse` does, or None after adding its faults to `faults`."""
    try:
        return parse(schema, values, prefix, others)
    except ConfigError as error:
        faults += error.faults
        return None


class Key(NamedTuple):
    """One key of a schema, for tables; `absent` is the value of a missing key, REQUIRED if it must be given."""

    name: str
    type: str
    range: str
    unit: str
    meaning: str
    absent: Any


def keys(schema: type) -> list[Key]:
    columns = ((f.name, f.metadata["kind"], f.metadata) for f in dataclasses.fields(schema))
    return [Key(name, kind.type, kind.range, kind.unit, more["doc"], more["absent"]) for name, kind, more in columns]


def required(schema: type) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(schema) if f.metadata["absent"] is REQUIRED)


class _Kind(NamedTuple):
    """The values that a key may have; `read` returns the value, or raises a ValueError."""

    read: Callable[[Any], Any]
    allowed: str
    type: str
    range: str = ""
    unit: str = ""
    is_text: bool = False

    def cure(self, value: Any) -> str:
        """Returns the end of the sentence about a bad value: how a text stays one."""
        each = value if isinstance(value, (list, tuple)) else [value]
        lost = self.is_text and not all(isinstance(one, (str, list, tuple, Mapping)) for one in each)
        return f"; {QUOTE_IT}" if lost else ""

    @property
    def allowed_with_unit(self) -> str:
        return f"{self.allowed} {self.unit}".rstrip()


class _Range(NamedTuple):
    """An end of a range that is None is unbounded."""

    low: float | None = None
    high: float | None = None
    above: float | None = None
    below: float | None = None

    def number(self, value: Any) -> float:
        """Returns a finite number in the range, or raises a ValueError."""
        if not is_number(value):
            raise ValueError
        if (
            (self.low is not None and value < self.low)
            or (self.high is not None and value > self.high)
            or (self.above is not None and value <= self.above)
            or (self.below is not None and value >= self.below)
        ):
            raise ValueError
        return float(value)

    @property
    def within(self) -> str:
        return f" in {self}" if str(self) else ""

    def __str__(self) -> str:
        if all(bound is None for bound in self):
            return ""
        left = f"[{self.low:g}" if self.low is not None else f"({self.above:g}" if self.above is not None else "(-inf"
        right = f"{self.high:g}]" if self.high is not None else f"{self.below:g})" if self.below is not None else "inf)"
        return f"{left}, {right}"


def _instance(value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise ValueError
    return value


def _field(kind: _Kind, doc: str, absent: Any) -> Any:
    absent = absent if absent is REQUIRED or absent is None else kind.read(absent)
    return dataclasses.field(metadata={"kind": kind, "doc": doc, "absent": absent})

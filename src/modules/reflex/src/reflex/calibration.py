"""Calibration of a hand, and the yaml text in which it is kept. Pure: no files.

Keys and layout are those of the maker's driver: a comment line, then flow lists, six significant digits for angles.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

import numpy as np
import yaml

from reflex.codec import StatePacket
from reflex.conversions import ENCODER_RAD, SIGNS, zero_reference
from reflex.errors import CalibrationFileError

_Record = TypeVar("_Record")


def _range(length: int, unit: str, low: float, high: float) -> Any:
    return field(metadata={"length": length, "unit": unit, "low": low, "high": high})


@dataclass(frozen=True)
class FingerZeros:
    """Where the hand is open."""

    encoder_zero_reference: np.ndarray = _range(3, "rad", -6.3, 6.3)  # angles of the knuckle encoders, shape (3,) [rad]
    motor_zero_reference: np.ndarray = _range(4, "rad", 0.0, 300.0)  # positions of the motors, shape (4,) [joint rad]


@dataclass(frozen=True)
class TactileOffsets:
    """Raw counts of untouched taxels, shape (9,) for each finger, in the finger's own order."""

    tactile_offset_f1: np.ndarray = _range(9, "counts", 0, 65535)
    tactile_offset_f2: np.ndarray = _range(9, "counts", 0, 65535)
    tactile_offset_f3: np.ndarray = _range(9, "counts", 0, 65535)

    def of_finger(self, finger: int) -> np.ndarray:
        """Returns the offsets of finger 0, 1 or 2, shape (9,)."""
        return (self.tactile_offset_f1, self.tactile_offset_f2, self.tactile_offset_f3)[finger]


DEFAULT_ZEROS = FingerZeros(np.array([3.0, 3.0, 3.0]), np.array([59.0, 57.0, 58.0, 55.0]))
DEFAULT_OFFSETS = TactileOffsets(*(np.full(9, 140.0) for _ in range(3)))
"""Values for no hand in particular; a hand with these refuses commands until its fingers are calibrated."""


def zeros_here(encoders: tuple[int, ...], positions: tuple[int, ...], slack: int) -> FingerZeros:
    """Returns the zeros of a hand whose fingers are open but have their tendons drawn in by `slack` [ticks].

    Takes the knuckle encoders [counts] and the servo positions [ticks]; preshape is at its zero.
    """
    return FingerZeros(
        np.array([raw * ENCODER_RAD for raw in encoders]),
        np.array([zero_reference(i, raw) for i, raw in enumerate(open_positions(positions, slack))]),
    )


def open_positions(positions: tuple[int, ...], slack: int) -> tuple[int, ...]:
    """Returns the servo positions [ticks] with the fingers' motors let out by `slack` ticks; preshape stays."""
    return (*(raw - sign * slack for raw, sign in zip(positions[:3], SIGNS)), positions[3])


def mean_offsets(packets: list[StatePacket]) -> TactileOffsets:
    """Returns the mean counts of the packets as offsets, rounded to whole counts."""
    means = np.rint(np.mean([p.pressures for p in packets], axis=0))
    return TactileOffsets(*means)


def zeros_text(zeros: FingerZeros) -> str:
    """Returns the text of finger_calibrate.yaml."""
    return (
        "# Written by the driver when the fingers are calibrated [rad].\n"
        f"encoder_zero_reference: {_flow(zeros.encoder_zero_reference)}\n"
        f"motor_zero_reference: {_flow(zeros.motor_zero_reference)}\n"
    )


def offsets_text(offsets: TactileOffsets) -> str:
    """Returns the text of tactile_calibrate.yaml."""
    lines = [f"tactile_offset_f{i + 1}: {_flow(offsets.of_finger(i))}\n" for i in range(3)]
    return "# Written by the driver when the tactile sensors are zeroed [counts].\n" + "".join(lines)


def calibration_from_text(record: type[_Record], text: str, where: str) -> _Record:
    """Returns FingerZeros or TactileOffsets from the text of their file; `where` names the file in the messages.

    Raises:
        CalibrationFileError: not yaml, or a key is missing, unknown or out of range.
    """
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise CalibrationFileError(f"{where} is not yaml: {' '.join(str(error).split())}.") from None
    if not isinstance(values, dict):
        raise CalibrationFileError(f"{where} is {values!r}, but must be a mapping of keys to values.")
    known = {f.name: f.metadata for f in fields(record)}  # type: ignore[arg-type]  # a TypeVar cannot say "a dataclass"
    faults = [f"{where}: {key} is not a known key; known are {', '.join(known)}." for key in values if key not in known]
    read = {}
    for name, allowed in known.items():
        value = values.get(name)
        if not _in_range(value, allowed):
            faults.append(
                f"{where}: {name} is {value!r}, but must be a list of {allowed['length']} numbers in "
                f"[{allowed['low']:g}, {allowed['high']:g}] {allowed['unit']}."
            )
            continue
        read[name] = np.array(value, dtype=float)
        read[name].setflags(write=False)
    if faults:
        raise CalibrationFileError(*faults)
    return record(**read)


def _in_range(value: Any, allowed: Any) -> bool:
    return (
        isinstance(value, (list, tuple))
        and len(value) == allowed["length"]
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value)
        and all(allowed["low"] <= v <= allowed["high"] for v in value)
    )


def _flow(values: np.ndarray) -> str:
    # Without exponents, which yaml takes for text where they have no decimal point.
    digits = (np.format_float_positional(v, precision=6, unique=False, fractional=False, trim="-") for v in values)
    return f"[{', '.join(digits)}]"

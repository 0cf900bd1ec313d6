"""What a hand's calibration consists of, and the yaml text in which it is kept. Pure: no files.

Keys and layout are those of the maker's driver: a comment line, then flow lists, six significant digits for angles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import yaml

from common.config import Schema, parse, vector
from common.errors import ConfigError
from reflex.codec import StatePacket
from reflex.conversions import ENCODER_RAD, SIGNS, zero_reference


@dataclass(frozen=True)
class FingerZeros:
    """Where the hand is open: encoder angles, shape (3,) [rad], and motors, shape (4,) [joint rad]."""

    encoder_zero_reference: np.ndarray = vector(3, "rad", low=-6.3, high=6.3, doc="encoder angle that counts as open")
    motor_zero_reference: np.ndarray = vector(4, "rad", low=0, high=300, doc="motor position that counts as open")


@dataclass(frozen=True)
class TactileOffsets:
    """Raw counts of untouched sensors, shape (9,) for each finger, sensors in the finger's own order."""

    tactile_offset_f1: np.ndarray = vector(9, "counts", low=0, high=65535, doc="untouched sensors of f1")
    tactile_offset_f2: np.ndarray = vector(9, "counts", low=0, high=65535, doc="untouched sensors of f2")
    tactile_offset_f3: np.ndarray = vector(9, "counts", low=0, high=65535, doc="untouched sensors of f3")

    def of_finger(self, finger: int) -> np.ndarray:
        """Returns the offsets of finger 0, 1 or 2, shape (9,)."""
        return (self.tactile_offset_f1, self.tactile_offset_f2, self.tactile_offset_f3)[finger]


def zeros_here(encoders: tuple[int, ...], positions: tuple[int, ...], slack: int) -> FingerZeros:
    """Returns the zeros of a hand whose fingers are open but have their tendons drawn in.

    Args:
        encoders: knuckle encoders of the open fingers [counts].
        positions: servo positions [ticks].
        slack: how far the fingers' motors are let out from here to their zero [ticks]; preshape stays.
    """
    return FingerZeros(
        np.array([raw * ENCODER_RAD for raw in encoders]),
        np.array([zero_reference(i, raw) for i, raw in enumerate(open_positions(positions, slack))]),
    )


def open_positions(positions: tuple[int, ...], slack: int) -> tuple[int, ...]:
    """Returns the servo positions [ticks] with the fingers' motors let out by `slack` ticks; preshape stays."""
    return (*(raw - sign * slack for raw, sign in zip(positions[:3], SIGNS)), positions[3])


def mean_offsets(packets: list[StatePacket]) -> TactileOffsets:
    """Returns the mean counts of some packets as offsets, rounded to whole counts."""
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


def zeros_from_text(text: str, where: str) -> FingerZeros:
    """Returns the zeros in the text of a finger_calibrate.yaml; `where` names the file in the messages.

    Raises:
        ConfigError: not yaml, or a key is missing, unknown or out of range.
    """
    return _parse(FingerZeros, text, where)


def offsets_from_text(text: str, where: str) -> TactileOffsets:
    """Returns the offsets in the text of a tactile_calibrate.yaml; `where` names the file in the messages.

    Raises:
        ConfigError: not yaml, or a key is missing, unknown or out of range.
    """
    return _parse(TactileOffsets, text, where)


def _parse(schema: type[Schema], text: str, where: str) -> Schema:
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError([f"{where} is not yaml: {' '.join(str(error).split())}."]) from None
    return parse(schema, values, prefix=f"{where}: ")


def _flow(values: np.ndarray) -> str:
    # Without exponents, which yaml takes for text where they have no decimal point.
    digits = (np.format_float_positional(v, precision=6, unique=False, fractional=False, trim="-") for v in values)
    return f"[{', '.join(digits)}]"

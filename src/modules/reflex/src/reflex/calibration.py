"""Calibration of a hand, the yaml text in which it is kept, and how its fingers are calibrated. Pure: no files. Keys
and layout are those of the maker's driver: a comment line, then flow lists, six significant digits for angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, TypeVar

import numpy as np
import yaml

from reflex.codec import StatePacket
from reflex.conversions import ENCODER_RAD, FINGERS, PI, SIGNS, TURN_TICKS, servo_fault, zero_reference
from reflex.errors import CalibrationFileError
from reflex.settings import HandSettings

Calibration = TypeVar("Calibration", "FingerZeros", "TactileOffsets")
SIMULATED = "simulated"  # key of a file; the maker's driver does not write it


def _range(length: int, unit: str, low: float, high: float) -> Any:
    return field(metadata={"length": length, "unit": unit, "low": low, "high": high})


@dataclass(frozen=True)
class FingerZeros:
    """Where the hand is open."""

    FILE: ClassVar = "finger_calibrate.yaml"
    HEADING: ClassVar = "# Written by the driver when the fingers are calibrated [rad].\n"
    encoder_zero_reference: np.ndarray = _range(3, "rad", -6.3, 6.3)  # angles of the knuckle encoders, shape (3,) [rad]
    motor_zero_reference: np.ndarray = _range(4, "rad", 0.0, 300.0)  # positions of the motors, shape (4,) [joint rad]


@dataclass(frozen=True)
class TactileOffsets:
    """Raw counts of untouched taxels, shape (9,) for each finger, in the finger's own order."""

    FILE: ClassVar = "tactile_calibrate.yaml"
    HEADING: ClassVar = "# Written by the driver when the tactile sensors are zeroed [counts].\n"
    tactile_offset_f1: np.ndarray = _range(9, "counts", 0, 65535)
    tactile_offset_f2: np.ndarray = _range(9, "counts", 0, 65535)
    tactile_offset_f3: np.ndarray = _range(9, "counts", 0, 65535)

    @property
    def rows(self) -> tuple[np.ndarray, ...]:
        """The offsets of f1, f2, f3."""
        return (self.tactile_offset_f1, self.tactile_offset_f2, self.tactile_offset_f3)


DEFAULTS: dict[type, Any] = {
    FingerZeros: FingerZeros(np.array([3.0, 3.0, 3.0]), np.array([59.0, 57.0, 58.0, 55.0])),
    TactileOffsets: TactileOffsets(*np.full((3, 9), 140.0)),
}
"""Values for no hand in particular; a hand with these refuses commands until its fingers are calibrated."""


def zeros_here(encoders: tuple[int, ...], positions: tuple[int, ...], slack: int) -> FingerZeros:
    """Returns the zeros of a hand whose fingers are open but have their tendons drawn in by `slack` [ticks], from
    the knuckle encoders [counts] and the servo positions [ticks]; preshape is at its zero."""
    return FingerZeros(
        np.array([raw * ENCODER_RAD for raw in encoders]),
        np.array([zero_reference(i, raw) for i, raw in enumerate(open_positions(positions, slack))]),
    )


def open_positions(positions: tuple[int, ...], slack: int) -> tuple[int, ...]:
    """Returns the servo positions [ticks] with the fingers' motors let out by `slack` ticks; preshape stays."""
    return (*(raw - sign * slack for raw, sign in zip(positions[:3], SIGNS)), positions[3])


def mean_offsets(packets: list[StatePacket]) -> TactileOffsets:
    """Returns the mean counts of the packets as offsets, rounded to whole counts."""
    return TactileOffsets(*np.rint(np.mean([p.pressures for p in packets], axis=0)))


def calibration_text(calibration: FingerZeros | TactileOffsets, simulated: bool = False) -> str:
    """Returns the text of the calibration's file, which records whether it is a `simulated` hand's."""
    rows = (f"{key}: [{', '.join(map(_digits, values))}]\n" for key, values in vars(calibration).items())
    return f"{calibration.HEADING}{''.join(rows)}{SIMULATED}: {str(simulated).lower()}\n"


def parse_calibration(record: type[Calibration], text: str, where: str, simulated: bool = False) -> Calibration:
    """Returns FingerZeros or TactileOffsets from the text of their file, named `where` in the messages; raises
    CalibrationFileError if it is not yaml, a key is missing, unknown or out of range, or it is a simulated hand's
    and this one is not `simulated`."""
    try:
        values = yaml.safe_load(text)
    except Exception as error:  # the library's constructors raise anything: ValueError for the date 2001-13-45
        raise CalibrationFileError(f"{where} is not yaml: {' '.join(str(error).split())}.") from None
    if not isinstance(values, dict):
        raise CalibrationFileError(f"{where} is {values!r}, but must be a mapping of keys to values.")
    known = {f.name: f.metadata for f in fields(record)}
    origin = values.pop(SIMULATED, False)
    if not isinstance(origin, bool):
        raise CalibrationFileError(f"{where}: {SIMULATED} is {origin!r}, but must be true or false.")
    if origin and not simulated:
        raise CalibrationFileError(
            f"{where} is of the simulated hand, which says nothing of a real one: it is not used. Delete it, and "
            "calibrate fingers and taxels again."
        )
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


def _digits(value: float) -> str:
    """Without an exponent, which yaml takes for text where it has no decimal point."""
    return np.format_float_positional(value, precision=6, unique=False, fractional=False, trim="-")


@dataclass(frozen=True)
class CalibrationStep:
    """Result of a packet."""

    target: tuple[int, ...] | None = None  # positions to send [ticks], or None
    zeros: FingerZeros | None = None  # the result, when the calibration has succeeded
    failure: str = ""  # reason of a failure as a sentence, or empty


class FingerCalibration:
    """Finds the open position of the fingers: draws the tendons in, step by step, until each knuckle begins to turn.
    The user opens the fingers first: the present encoder values are the encoders' zeros; the motors' zeros lie a slack
    before the point where the knuckle turned. It gives up, with a sentence, on a bound of closing, time or load and on
    servos that do not answer."""

    def __init__(self, settings: HandSettings) -> None:
        self._settings = settings
        self._encoders: tuple[int, ...] = ()
        self._last_positions: tuple[int, ...] = ()
        self._start_time = self._round_time = 0.0
        self._origin: list[int] = []
        self._held: list[int | None] = [None] * 3

    def step(self, packet: StatePacket, loads: Sequence[float], now: float) -> CalibrationStep:
        """Handles the next packet, received at `now` [s], with the filtered loads [0.1 %] of the motors."""
        fault = servo_fault(packet.positions)
        if fault:
            return CalibrationStep(failure=fault)
        if not self._encoders:
            self._encoders, self._start_time, self._round_time = packet.encoders, now, now
            self._origin = list(packet.positions)
            self._last_positions = packet.positions
            return CalibrationStep(target=self._closer(packet))
        turned = self._follow_jumps(packet)
        self._last_positions = packet.positions
        if turned is None:
            return CalibrationStep(
                packet.positions, failure="A servo's position jumped: its reports cannot be trusted."
            )
        failure = self._bound_reached(packet, loads, now)
        if failure:
            return CalibrationStep(target=tuple(self._origin), failure=failure)
        for i in range(3):
            if self._held[i] is None and self._knuckle_turn(packet, i) > self._settings.calibration_moved:
                self._held[i] = packet.positions[i]
        held = [h for h in self._held if h is not None]
        if len(held) == len(self._held):
            slack = self._settings.calibration_slack
            positions = (*held, packet.positions[3])
            return CalibrationStep(open_positions(positions, slack), zeros_here(self._encoders, positions, slack))
        if turned or now - self._round_time >= self._settings.calibration_round:
            self._round_time = now
            return CalibrationStep(target=self._closer(packet))
        return CalibrationStep()

    def _closer(self, packet: StatePacket) -> tuple[int, ...]:
        step = self._settings.calibration_step
        closer = [packet.positions[i] + SIGNS[i] * step for i in range(3)]
        fingers = [new if held is None else held for new, held in zip(closer, self._held)]
        return (*fingers, self._origin[3])

    def _follow_jumps(self, packet: StatePacket) -> bool | None:
        """Whether a servo now counts from another turn, so that its target lies a turn away; None after other jumps."""
        jump_ticks = 200
        turn_tolerance_ticks = 40
        turned = False
        for i, (raw, last) in enumerate(zip(packet.positions, self._last_positions)):
            jump = raw - last
            if abs(jump) <= jump_ticks:
                continue
            if abs(abs(jump) - TURN_TICKS) > turn_tolerance_ticks:
                return None
            turned = True
            self._origin[i] += jump
            held = self._held[i] if i < 3 else None
            if held is not None:
                self._held[i] = held + jump
        return turned

    def _knuckle_turn(self, packet: StatePacket, finger: int) -> float:
        """Returns how far the knuckle has closed since the start [rad], across the encoder's end."""
        turn = (self._encoders[finger] - packet.encoders[finger]) * ENCODER_RAD
        return (turn + PI) % (2 * PI) - PI

    def _bound_reached(self, packet: StatePacket, loads: Sequence[float], now: float) -> str:
        settings = self._settings
        for i, name in enumerate(FINGERS):
            closed = SIGNS[i] * (packet.positions[i] - self._origin[i])
            if closed > settings.calibration_max_closing - settings.calibration_step and self._held[i] is None:
                if self._knuckle_turn(packet, i) > settings.calibration_moved:
                    continue
                return f"Finger {name} was closed by {closed} ticks and its knuckle encoder did not turn."
            if abs(loads[i]) > settings.calibration_max_load:
                return f"Motor {name} has a load of {loads[i]:.0f} during the calibration: is it blocked?"
        if now - self._start_time > settings.calibration_max_time:
            waiting = ", ".join(name for name, held in zip(FINGERS, self._held) if held is None)
            return f"After {settings.calibration_max_time:g} s the knuckles of {waiting} had not turned."
        return ""

"""The hand's side of its wire: packs state packets, reads commands. Written from the packet description
(docs/handbook/wire-protocols.md, "Hand: ReFlex"), not from the driver's codec, so that tests of one against the other
find mistakes in either."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

GROUP = "224.0.0.124"
STATE_BYTES = 202
IDLE = 0
VELOCITY = 1
POSITION = 2
_FORMAT_CODE = 1
_MODE_CODE = 1
_TARGET_CODE = 2
_MODE_BYTES = 5
_TARGET_BYTES = 9
_PALM_BANK = (0,) * 11
_SENSOR_TEMPERATURES = (512,) * 38
# Sensor banks are sent in another order than encoders and servos: f1, f3, f2.
_BANKS = (0, 2, 1)


@dataclass(frozen=True)
class ModeCommand:
    """Modes of f1, f2, f3, preshape."""

    modes: tuple[int, ...]


@dataclass(frozen=True)
class TargetCommand:
    """Targets of f1, f2, f3, preshape: positions or speeds, depending on the mode."""

    values: tuple[int, ...]


def read_command(data: bytes) -> ModeCommand | TargetCommand | None:
    """Returns the command in a datagram of sufficient length; None for unknown codes and for state packets."""
    if not data or len(data) == STATE_BYTES:
        return None
    if data[0] == _MODE_CODE and len(data) >= _MODE_BYTES:
        return ModeCommand(tuple(data[1:5]))
    if data[0] == _TARGET_CODE and len(data) >= _TARGET_BYTES:
        return TargetCommand(tuple(int.from_bytes(data[i : i + 2], "big") for i in (1, 3, 5, 7)))
    return None


def pack_state(
    device_time: int,
    pressures: Sequence[Sequence[int]],
    encoders: Sequence[int],
    errors: Sequence[int],
    positions: Sequence[int],
    speeds: Sequence[int],
    loads: Sequence[int],
    voltages: Sequence[int],
    temperatures: Sequence[int],
) -> bytes:
    """Returns a state packet; `pressures` and `encoders` by finger, everything else by motor, raw counts."""
    parts = [struct.pack("<BxxxI", _FORMAT_CODE, device_time)]
    parts += [struct.pack("<9H", *pressures[finger]) for finger in _BANKS]
    parts.append(struct.pack("<11H", *_PALM_BANK))
    parts.append(struct.pack("<38H", *_SENSOR_TEMPERATURES))
    parts.append(struct.pack("<3H", *encoders))
    parts.append(bytes(errors))
    parts += [struct.pack("<4H", *registers) for registers in (positions, speeds, loads)]
    parts += [bytes(voltages), bytes(temperatures)]
    return b"".join(parts)

"""The bytes of the ReFlex TakkTile hand: state packets come in little endian, command packets go out big endian.
Pure. Raw counts only; `conversions` turns them into radians. The wire carries no sequence number and no checksum.
The first byte of a state packet equals the code of the mode command, so the length distinguishes them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

GROUP = "224.0.0.124"
STATE_BYTES = 202
IDLE, VELOCITY, POSITION = range(3)

_STATE_CODE, _MODE_CODE, _TARGET_CODE = 1, 1, 2
_LAST_RAW = 65535

_STATE = struct.Struct("<B3xI 9H9H9H 11H38H 3H 4B 4H4H4H 4B4B")
_GROUPS = (9, 9, 9, 11, 38, 3, 4, 4, 4, 4, 4, 4)
"""Numbers of a state packet: the banks of f1, f3, f2 and palm, temperatures, then the fields of StatePacket."""

_MODE = struct.Struct(">B4B")
_TARGET = struct.Struct(">B4H")


class PacketError(ValueError):
    """A datagram is not a state packet of this hand."""


@dataclass(frozen=True)
class StatePacket:
    """One state packet; fingers in the order f1, f2, f3, motors f1, f2, f3, preshape."""

    device_time: int  # microseconds since the hand was switched on; wraps at 2**32
    pressures: tuple[tuple[int, ...], ...]  # three times nine raw tactile counts
    encoders: tuple[int, ...]  # knuckle encoders, 14 bits each
    errors: tuple[int, ...]  # error bits of each servo
    positions: tuple[int, ...]  # present position of each servo [ticks]
    speeds: tuple[int, ...]  # present-speed register of each servo
    loads: tuple[int, ...]  # present-load register of each servo
    voltages: tuple[int, ...]  # supply of each servo [0.1 V]
    temperatures: tuple[int, ...]  # of each servo [degrees Celsius]


def decode_state(data: bytes) -> StatePacket:
    """Returns the state packet in `data`, without the palm's bank and the sensors' temperatures; raises PacketError
    for a wrong format code or length."""
    if not data or data[0] != _STATE_CODE:
        raise PacketError(f"A datagram begins with {data[:1].hex() or 'nothing'}; state packets begin with 01.")
    if len(data) != STATE_BYTES:
        raise PacketError(f"A state packet has {STATE_BYTES} bytes, this datagram {len(data)}.")
    _, device_time, *v = _STATE.unpack(data)
    bank_f1, bank_f3, bank_f2, _, _, *rest = (tuple(v[end - n : end]) for n, end in zip(_GROUPS, accumulate(_GROUPS)))
    return StatePacket(device_time, (bank_f1, bank_f2, bank_f3), *rest)


def encode_mode(mode: int) -> bytes:
    """Returns the packet that puts all motors into `mode`: IDLE, VELOCITY or POSITION; raises ValueError for others."""
    if mode not in (IDLE, VELOCITY, POSITION):
        raise ValueError(f"the hand knows the modes 0, 1 and 2, not {mode!r}")
    return _MODE.pack(_MODE_CODE, mode, mode, mode, mode)


def encode_target(raw: Sequence[int]) -> bytes:
    """Returns the packet with the targets of f1, f2, f3, preshape: ticks in position mode, units in velocity mode;
    raises ValueError unless they are four whole numbers in 0..65535."""
    if len(raw) != 4 or not all(isinstance(r, int) and 0 <= r <= _LAST_RAW for r in raw):
        raise ValueError(f"targets are four whole numbers in 0..{_LAST_RAW}, not {list(raw)}")
    return _TARGET.pack(_TARGET_CODE, *raw)


def is_command(data: bytes) -> bool:
    """Returns whether `data` is a packet from a host to the hand; a host receives those of other hosts."""
    return (len(data), data[:1]) in ((_MODE.size, bytes([_MODE_CODE])), (_TARGET.size, bytes([_TARGET_CODE])))

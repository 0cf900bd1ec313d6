"""Measurements of the hand in units of its joints: the maker's conversions of a state packet. Fingers f1, f2, f3
(index, middle, thumb), motors f1, f2, f3, preshape; angles in rad, 0 = open."""

from __future__ import annotations

from dataclasses import dataclass

from reflex.calibration import FingerZeros, TactileOffsets
from reflex.codec import StatePacket
from reflex.conversions import all_joint_angles, closing_load, proximal_angle

UNLOADED = (0.0,) * 4
JOINT_NAMES = (
    "reflex/preshape_1", "reflex/preshape_2",
    "reflex/proximal_joint_1", "reflex/proximal_joint_2", "reflex/proximal_joint_3",
    "reflex/distal_joint_1", "reflex/distal_joint_2", "reflex/distal_joint_3",
)  # fmt: skip


@dataclass(frozen=True)
class HandReading:
    """A state packet in units of the joints."""

    proximal: tuple[float, ...]  # turn of each knuckle [rad]
    distal: tuple[float, ...]  # estimated flexion of each finger's outer link [rad], never negative
    pressure: tuple[tuple[int, ...], ...]  # three times nine counts above the untouched sensor
    contact: tuple[tuple[bool, ...], ...]  # three times nine, whether the pressure is above the taxel's threshold
    joint_angles: tuple[float, ...]  # turn of each motor's spool [rad]
    loads: tuple[float, ...]  # filtered load of each motor [0.1 % of the largest torque], positive = closing effort
    packet: StatePacket  # the raw counts

    @property
    def dead_taxels(self) -> tuple[str, ...]:
        """Taxels that never answered the hand, such as "f1.3"; their raw count is 0."""
        return tuple(
            f"f{finger + 1}.{taxel}"
            for finger, counts in enumerate(self.packet.pressures)
            for taxel, count in enumerate(counts)
            if count == 0
        )


def measure(
    packet: StatePacket,
    zeros: FingerZeros,
    offsets: TactileOffsets,
    thresholds: tuple[tuple[int, ...], ...],
    loads: tuple[float, ...] = UNLOADED,
) -> HandReading:
    """Returns the reading of a packet; `thresholds` are three times nine counts, `loads` those of the last reading."""
    new_load_weight = 0.25
    filtered = tuple(
        new_load_weight * closing_load(i, raw) + (1 - new_load_weight) * old
        for i, (raw, old) in enumerate(zip(packet.loads, loads))
    )
    angles = all_joint_angles(packet.positions, zeros.motor_zero_reference)
    proximal = tuple(proximal_angle(r, z) for r, z in zip(packet.encoders, zeros.encoder_zero_reference))
    pressure = tuple(
        tuple(raw - int(zero) for raw, zero in zip(counts, untouched))
        for counts, untouched in zip(packet.pressures, offsets.rows)
    )
    contact = tuple(tuple(p > t for p, t in zip(*rows)) for rows in zip(pressure, thresholds))
    distal = tuple(max(0.0, angle - p) for angle, p in zip(angles, proximal))
    return HandReading(proximal, distal, pressure, contact, angles, filtered, packet)


def joint_positions(reading: HandReading) -> tuple[float, ...]:
    """Returns the positions [rad] of the joints of the hand's model, in the order of JOINT_NAMES. The two swivels
    turn against each other about axes that point the same way."""
    spread = reading.joint_angles[3]
    return (spread, -spread, *reading.proximal, *reading.distal)

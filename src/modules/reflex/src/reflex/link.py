"""Filters the datagrams on the hand's multicast group, and finds pauses and restarts of the hand. Pure: datagrams,
their senders and the time [s] come in as arguments. The device time in a state packet is the hand's clock
[microseconds since power-up], which tells a pause of the network from a restart of the hand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from reflex.codec import PacketError, StatePacket, decode_state, is_command
from reflex.stranger import stranger

PERIOD_S = 0.025

_FOREIGN_S = 5.0  # what another sender said explains a silence for so long


class PacketArrival(Enum):
    """Relation of a datagram to the packet before it."""

    DROPPED = "dropped"
    FIRST = "first"
    NEXT = "next"
    RESUMED = "resumed"
    RESTARTED = "restarted"


@dataclass
class PacketCounts:
    """Datagrams so far."""

    packets: int = 0
    lost: int = 0
    late: int = 0
    repeated: int = 0
    malformed: int = 0
    other_hands: int = 0
    other_hosts: int = 0
    restarts: int = 0


class PacketFilter:
    """Separates the packets of one hand from everything else; without one for `silence_time` [s] it is silent."""

    def __init__(self, silence_time: float) -> None:
        self._silence_time = silence_time
        self._last: StatePacket | None = None
        self._last_time = -math.inf
        self._source: tuple = ()
        self._missed = False
        self._foreign = (-math.inf, "")  # when another sender was heard last, and a sentence about it
        self.counts = PacketCounts()

    def heard(self) -> bool:
        return self._last is not None

    def alive(self, now: float) -> bool:
        """Whether a packet came within the silence time."""
        return self.age(now) <= self._silence_time

    def watch(self, now: float) -> bool:
        """Returns true once, when a silence begins."""
        begins = self.heard() and not self.alive(now) and not self._missed
        self._missed = self._missed or begins
        return begins

    def age(self, now: float) -> float:
        """Returns the time since the last packet [s]; infinite before the first."""
        return now - self._last_time

    def foreign(self, now: float) -> str:
        """Returns a sentence about what is heard in place of the hand, or an empty text."""
        heard_at, sentence = self._foreign
        return sentence if now - heard_at <= _FOREIGN_S and not self.alive(now) else ""

    def sort(self, data: bytes, source: tuple, now: float) -> tuple[PacketArrival, StatePacket | None, str]:
        """Returns the arrival of a datagram, its packet unless dropped, and the reason of a drop as a sentence."""
        if is_command(data):
            self.counts.other_hosts += 1
            self._foreign = now, f"Another program ({_name(source)}) sends commands to the hand."
            return PacketArrival.DROPPED, None, self._foreign[1]
        try:
            packet = decode_state(data)
        except PacketError as error:
            self.counts.malformed += 1
            if source == self._source:
                return PacketArrival.DROPPED, None, f"{error} It came from {_name(source)}."
            what = stranger(_name(source), "the hand", data)
            self._foreign = now, f"{what[0].upper()}{what[1:]}. {error}"
            return PacketArrival.DROPPED, None, self._foreign[1]
        if self.alive(now) and source != self._source:
            self.counts.other_hands += 1
            why = f"A second hand ({_name(source)}) sends on the port of the first ({_name(self._source)})."
            return PacketArrival.DROPPED, None, why
        arrival = self._relate(packet, now)
        if arrival is PacketArrival.DROPPED:
            self.counts.repeated += 1
            return arrival, None, ""
        self.counts.packets += 1
        self.counts.restarts += arrival is PacketArrival.RESTARTED
        self._last, self._last_time, self._source, self._missed = packet, now, source, False
        return arrival, packet, ""

    def _relate(self, packet: StatePacket, now: float) -> PacketArrival:
        """Compares the hand's clock with the host's. A busy host reads packets late, so the hand's clock only
        appears to fall behind: that counts as a restart only after a silence that `watch` reported."""
        clock_tolerance_s = 0.3
        clock_drift = 1e-3
        longest_reordering_s = 0.2
        if self._last is None:
            return PacketArrival.FIRST
        host_step = now - self._last_time
        device_step = _signed(1e-6 * (packet.device_time - self._last.device_time))
        repeated = device_step == 0 and host_step < PERIOD_S / 2
        if not self._missed and (repeated or -longest_reordering_s < device_step < 0):
            return PacketArrival.DROPPED
        behind = _signed(host_step - device_step)
        tolerance = clock_tolerance_s + clock_drift * host_step
        if behind < -tolerance or (self._missed and behind > tolerance) or (not self._missed and device_step < 0):
            return PacketArrival.RESTARTED
        if self._missed:
            return PacketArrival.RESUMED
        self.counts.lost += max(0, round(device_step / PERIOD_S) - 1)
        self.counts.late += host_step - device_step > PERIOD_S
        return PacketArrival.NEXT


def _signed(step: float) -> float:
    """Returns the step [s] across the wrap of the hand's clock, at most half its range either way."""
    clock_wrap_s = 2**32 * 1e-6
    return (step + clock_wrap_s / 2) % clock_wrap_s - clock_wrap_s / 2


def _name(source: tuple) -> str:
    return f"{source[0]}:{source[1]}"

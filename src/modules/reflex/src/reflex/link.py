"""Sorts what comes in on the hand's multicast group: whole, from one hand, new, and in which relation to the last one.

Pure: datagrams, their senders and the time [s] are handed in. The device time in a state packet is the hand's own clock
[microseconds since it was switched on], which tells a pause of the network from a hand that was switched off.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from reflex.codec import PacketError, StatePacket, decode_state, is_command

PERIOD_S = 0.025
CLOCK_TOLERANCE_S = 1.0

_CLOCK_WRAP = 2**32
_MICROSECONDS = 1e-6
_LONGEST_REORDERING_S = 0.2


class Arrival(Enum):
    """What a datagram is."""

    DROPPED = "dropped"
    FIRST = "first"
    NEXT = "next"
    RESUMED = "resumed"
    RESTARTED = "restarted"


@dataclass
class Counters:
    """What came in so far."""

    packets: int = 0
    lost: int = 0
    late: int = 0
    repeated: int = 0
    malformed: int = 0
    other_hands: int = 0
    other_hosts: int = 0
    restarts: int = 0


class Link:
    """Tells the packets of the hand from everything else.

    Args:
        silence_time: without a packet for so long the hand is silent [s].
    """

    def __init__(self, silence_time: float) -> None:
        self._silence_time = silence_time
        self._last: StatePacket | None = None
        self._last_time = 0.0
        self._source: tuple | None = None
        self.counters = Counters()

    def heard(self) -> bool:
        """Whether a packet ever came."""
        return self._last is not None

    def alive(self, now: float) -> bool:
        """Whether a packet came within the silence time."""
        return self._last is not None and now - self._last_time <= self._silence_time

    def age(self, now: float) -> float:
        """Returns the time since the last packet [s]; infinite before the first."""
        return now - self._last_time if self._last is not None else float("inf")

    def sort(self, data: bytes, source: tuple, now: float) -> tuple[Arrival, StatePacket | None, str]:
        """Takes a datagram in.

        Args:
            data: the datagram.
            source: address and port of its sender.
            now: time of its arrival [s].

        Returns:
            What it is, the packet unless it is dropped, and why it was dropped, as a sentence.
        """
        if is_command(data):
            self.counters.other_hosts += 1
            return Arrival.DROPPED, None, f"Another program ({_name(source)}) sends commands to the hand."
        try:
            packet = decode_state(data)
        except PacketError as error:
            self.counters.malformed += 1
            return Arrival.DROPPED, None, f"{error} It came from {_name(source)}."
        if self.alive(now) and source != self._source:
            self.counters.other_hands += 1
            why = f"A second hand ({_name(source)}) sends on the port of the first ({_name(self._source)})."
            return Arrival.DROPPED, None, why
        arrival = self._relate(packet, now)
        if arrival is Arrival.DROPPED:
            self.counters.repeated += 1
            return arrival, None, ""
        self.counters.packets += 1
        self.counters.restarts += arrival is Arrival.RESTARTED
        self._last, self._last_time, self._source = packet, now, source
        return arrival, packet, ""

    def _relate(self, packet: StatePacket, now: float) -> Arrival:
        if self._last is None:
            return Arrival.FIRST
        host_step = now - self._last_time
        ticks = (packet.device_time - self._last.device_time) % _CLOCK_WRAP
        back = (_CLOCK_WRAP - ticks) * _MICROSECONDS
        if ticks == 0 and host_step < PERIOD_S / 2:
            return Arrival.DROPPED
        if ticks and back < _LONGEST_REORDERING_S and host_step <= self._silence_time:
            return Arrival.DROPPED
        device_step = ticks * _MICROSECONDS
        wrap = _CLOCK_WRAP * _MICROSECONDS
        apart = (host_step - device_step + wrap / 2) % wrap - wrap / 2
        if abs(apart) > CLOCK_TOLERANCE_S:
            return Arrival.RESTARTED
        if host_step > self._silence_time:
            return Arrival.RESUMED
        self.counters.lost += max(0, round(device_step / PERIOD_S) - 1)
        self.counters.late += host_step - device_step > PERIOD_S
        return Arrival.NEXT


def _name(source: tuple | None) -> str:
    return f"{source[0]}:{source[1]}" if source else "unknown"

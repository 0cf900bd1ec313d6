"""What a bad link does to packets, and the conditions of the table. Pure: packets and times come in, packets go out."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections import deque
from dataclasses import dataclass
from typing import Tuple

QUEUE_BYTES = 32_000  # a second at 256 kbit/s
TCP, UDP = 6, 17


@dataclass(frozen=True)
class Link:
    """How each of the two directions treats its packets. The default passes them on at once."""

    delay: float = 0.0  # [s]
    jitter: float = 0.0  # the delay is even between delay - jitter and delay + jitter, but keeps the order [s]
    loss: float = 0.0  # fraction of the packets; 1: the link is down
    reordered: float = 0.0  # fraction of the packets that skip the delay, and so overtake
    duplicated: float = 0.0  # fraction of the packets that arrive twice
    rate: float = math.inf  # [bit/s]
    queue: float = QUEUE_BYTES  # what does not fit in front of the rate is lost [bytes]
    held: bool = False  # nothing arrives until it is False again

    def __post_init__(self) -> None:
        fractions = self.loss, self.reordered, self.duplicated
        if not (0.0 <= self.jitter <= self.delay < math.inf and self.rate > 0.0 and self.queue > 0.0):
            raise ValueError(f"{self} has no sensible times")
        if not all(0.0 <= fraction <= 1.0 for fraction in fractions):
            raise ValueError(f"{self} has fractions that are not between 0 and 1")


CLEAR = Link()


class Way:
    """One direction of a link, which may change at any time; see Link. Times [s] never decrease."""

    def __init__(self, seed: int) -> None:
        self.link = CLEAR
        self.lost = 0  # packets so far
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, bytes]] = []
        self._numbers = itertools.count()
        self._newest = self._sent = -math.inf  # arrival of the last packet in order, end of the last sending [s]
        self._queued: deque[tuple[float, int]] = deque()  # end of the sending [s] and size [bytes]
        self._queued_bytes = 0

    def put(self, packet: bytes, now: float) -> None:
        """Takes a packet at the time `now`."""
        link = self.link
        sent = self._sending_ends(len(packet), now)
        if sent is None or self._random.random() < link.loss:
            self.lost += 1
            return
        if self._random.random() < link.reordered:
            arrival = sent
        else:
            delay = link.delay + self._random.uniform(-link.jitter, link.jitter)
            self._newest = arrival = max(sent + delay, self._newest)
        for _ in range(1 + (self._random.random() < link.duplicated)):
            heapq.heappush(self._waiting, (arrival, next(self._numbers), packet))

    def due(self) -> float:
        """Returns when the next packet arrives, infinity if none is under way or all are held."""
        return self._waiting[0][0] if self._waiting and not self.link.held else math.inf

    def take(self, now: float) -> list[bytes]:
        """Returns the packets that have arrived by the time `now`."""
        packets = []
        while self.due() <= now:
            packets.append(heapq.heappop(self._waiting)[2])
        return packets

    def _sending_ends(self, size: int, now: float) -> float | None:
        """Returns when a packet is sent at the link's rate, None if the queue is full."""
        while self._queued and self._queued[0][0] <= now:
            self._queued_bytes -= self._queued.popleft()[1]
        if math.isinf(self.link.rate):
            return now
        if self._queued_bytes + size > self.link.queue:
            return None
        self._sent = max(now, self._sent) + 8.0 * size / self.link.rate
        self._queued.append((self._sent, size))
        self._queued_bytes += size
        return self._sent


def exchanged(packet: bytes) -> bytes:
    """Returns an IPv4 packet with its two addresses exchanged, and otherwise as it is; no checksum depends on it."""
    return packet[:12] + packet[16:20] + packet[12:16] + packet[20:]


def direction(packet: bytes) -> int | None:
    """Returns 0 or 1, the same for all packets of one direction of a connection, None for what is not IPv4."""
    if len(packet) < 20 or packet[0] >> 4 != 4:
        return None
    header = 4 * (packet[0] & 0x0F)
    if packet[9] not in (TCP, UDP) or len(packet) < header + 4:
        return 0
    return int(packet[header : header + 2] > packet[header + 2 : header + 4])


Phase = Tuple[float, Link]
"""A link and how long it lasts [s]."""


@dataclass(frozen=True)
class Condition:
    """A row of the table: what it is called, and how the link changes. The last phase lasts as long as it takes."""

    title: str
    phases: tuple[Phase, ...]


def _always(title: str, link: Link) -> Condition:
    return Condition(title, ((math.inf, link),))


CONDITIONS = {
    "clear": _always("as it is", CLEAR),
    "delay_5": _always("delay 5 ms", Link(delay=0.005)),
    "delay_20": _always("delay 20 ms", Link(delay=0.02)),
    "delay_100": _always("delay 100 ms", Link(delay=0.1)),
    "jitter_50": _always("delay 50 ± 50 ms", Link(delay=0.05, jitter=0.05)),
    "loss_1": _always("loss 1 %", Link(loss=0.01)),
    "loss_5": _always("loss 5 %", Link(loss=0.05)),
    "loss_10": _always("loss 10 %", Link(loss=0.1)),
    "reordering": _always("25 % overtake, by 10 ms", Link(delay=0.01, reordered=0.25)),
    "duplicates": _always("10 % twice", Link(duplicated=0.1)),
    "freezes_300": Condition("frozen for 300 ms every 3 s", ((2.7, CLEAR), (0.3, Link(held=True))) * 20),
    "down_5": Condition("down for 5 s", ((5.0, CLEAR), (5.0, Link(loss=1.0)), (math.inf, CLEAR))),
    "rate_256": _always("256 kbit/s", Link(rate=256e3)),
    **{
        f"delay_{delay}_loss_{loss}": _always(f"delay {delay} ms, loss {loss} %", Link(1e-3 * delay, loss=1e-2 * loss))
        for delay in (20, 50, 100, 200)
        for loss in (0, 2, 5)
    },
}
"""The conditions of the table, each way, by name; the last twelve are those of the internet."""

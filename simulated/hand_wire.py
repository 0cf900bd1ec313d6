"""The ReFlex hand on its wire, in this process and in virtual time; ReflexHand reaches it by interface and port.

    with HandWire() as wire:
        node = graph.run("reflex", "reflex_takktile_driver.py")
        wire.faults.switch("silent")
        wire.hand.press(finger=1, cell=2, value=15)

The hand's own cycle runs, rig_simulation.devices.reflex.program.run, and its faults; in place of UDP there are lists.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque

import pytest

from common import clock
from reflex.client import ReflexHand
from reflex.errors import WireFault
from reflex.transport import HandTransport
from rig_simulation.devices.reflex import program
from rig_simulation.devices.reflex.hand import SimulatedHand
from rig_simulation.faults import hand as hand_faults
from rig_simulation.faults.injection import Faults
from simulated.scheduler import active

DELAY_S = 0.0005  # longest time of a packet
SOURCE = ("10.99.99.99", 11333)


class HandWire(contextlib.AbstractContextManager):
    """An interface with a hand that runs.

    Attributes:
        hand: the simulated hand.
        faults: those of HAND_FAULTS, in both directions.
        broken: why the interface is down, "" while it is up: what the host sends fails, and nothing comes.
    """

    def __init__(self, seed: int = 0, interface: str = "lo", port: int = 11333) -> None:
        self.interface, self.port, self.broken = interface, port, ""
        self.hand = SimulatedHand(seed)
        self.faults = Faults(hand_faults.HAND_FAULTS)
        self.wire = hand_faults.HandWire(self.faults)
        self.hosts: list[Transport] = []
        self._commands, self._stop, self._patch = Packets(), clock.Event(), pytest.MonkeyPatch()
        self._thread = clock.Thread(
            target=program.run, args=(self.hand, self, clock.Lock(), self._stop), name="simulated hand", daemon=True
        )

    def __enter__(self) -> HandWire:
        stand_ins = {HandTransport: self.connect}
        defaults = ReflexHand.__init__.__defaults__ or ()
        own = tuple(stand_ins.get(value, value) if isinstance(value, type) else value for value in defaults)
        self._patch.setattr(ReflexHand.__init__, "__defaults__", own)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._patch.undo()
        self._stop.set()
        self._thread.join()

    def connect(self, interface: str, port: int) -> Transport:
        """The host's side; raises WireFault for another interface. On another port there is no hand."""
        if interface != self.interface:
            usable = f"interfaces with an IPv4 address: {self.interface}"
            raise WireFault(f"The network interface {interface!r} does not exist; {usable}.")
        return Transport(self, port)

    def send(self, packet: bytes) -> None:
        """A packet of the hand."""
        for each in self.wire.outgoing(packet, clock.monotonic()):
            for host in [] if self.broken else self.hosts:
                host.packets.put(each)

    def take(self, command: bytes) -> None:
        """A packet of the host."""
        self._commands.put(command)

    def collect(self) -> list[bytes]:
        """The commands that have reached the hand since the last call."""
        found: list[bytes] = []
        while (command := self._commands.get(0.0)) is not None:
            found.append(command)
        return self.wire.incoming(found)


class Transport:
    """In place of reflex.transport.HandTransport."""

    def __init__(self, wire: HandWire, port: int) -> None:
        self._wire, self._hears = wire, port == wire.port
        self.packets = Packets()
        if self._hears:
            wire.hosts.append(self)

    def receive(self, timeout: float) -> tuple[bytes, tuple[str, int]] | None:
        """The next packet of the hand, and its sender; None after `timeout` [s]."""
        packet = self.packets.get(timeout)
        return None if packet is None else (packet, SOURCE)

    def send(self, data: bytes) -> None:
        """A packet to the hand."""
        if self._wire.broken:
            raise WireFault(f"Cannot send to {self._wire.interface}: {self._wire.broken}.")
        if self._hears:
            self._wire.take(data)

    def close(self) -> None:
        """Hears and sends nothing more."""
        self._hears = False
        if self in self._wire.hosts:
            self._wire.hosts.remove(self)


class Packets:
    """Packets on their way in one direction, in order."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._there = clock.Event()

    def put(self, packet: bytes) -> None:
        """Sends one."""
        due = clock.monotonic() + active().drawn(DELAY_S)
        self._waiting.append((max(due, self._waiting[-1][0]) if self._waiting else due, packet))
        self._there.set()

    def get(self, timeout: float) -> bytes | None:
        """Returns the next one, None after `timeout` [s]."""
        deadline = clock.monotonic() + timeout
        while (due := self._waiting[0][0] if self._waiting else math.inf) > (now := clock.monotonic()):
            if now >= deadline:
                return None
            self._there.clear()
            self._there.wait(max(min(due, deadline) - now, 1e-6))  # a shorter wait may be lost to rounding
        return self._waiting.popleft()[1]

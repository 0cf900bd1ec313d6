"""ReFlex hands on their wire, in this process and in virtual time; ReflexHand reaches them by interface and port.

    with HandWire() as wire:
        node = graph.run("reflex", "reflex_takktile_driver.py")
        wire.faults.switch("silent")
        wire.hand.press(finger=1, cell=2, value=15)

The hand's own cycle runs, rig_simulation.devices.reflex.program.run, and its faults; only UDP is replaced. With a
HandNetwork alone, programs such as world.py bring their hands."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections import deque

import pytest

from common import clock
from common.errors import DeviceError
from reflex import client
from reflex.errors import WireFault
from rig_simulation.devices.reflex import program
from rig_simulation.devices.reflex.hand import SimulatedHand
from rig_simulation.faults import hand as hand_faults
from rig_simulation.faults.injection import Faults
from simulated.scheduler import active

DELAY_S = 0.0005  # longest time of a packet
LEAST_S = 1e-6  # a shorter wait may be lost to rounding
FIRST_PORT = 50000  # of those that a hand gets for port 0
SOURCE = ("10.99.99.99", 11333)


class HandNetwork(contextlib.AbstractContextManager):
    """The only interface of this machine.

    Attributes:
        broken: why it is down, "" while it is up: what the host sends fails, and nothing comes.
        links: those of the hands, by their ports."""

    def __init__(self, interface: str = "lo") -> None:
        self.interface, self.broken = interface, ""
        self.links: dict[int, Link] = {}
        self.ports = itertools.count(FIRST_PORT)
        self._patch = pytest.MonkeyPatch()

    def __enter__(self) -> HandNetwork:
        self._patch.setattr(client, "HandTransport", self.connect)
        self._patch.setattr(program, "HandLink", self.link)
        return self

    def __exit__(self, *_: object) -> None:
        self._patch.undo()

    def connect(self, interface: str, port: int) -> Transport:
        """The host's side, in place of HandTransport; raises WireFault for another interface."""
        if interface != self.interface:
            usable = f"interfaces with an IPv4 address: {self.interface}"
            raise WireFault(f"The network interface {interface!r} does not exist; {usable}.")
        return Transport(self, port)

    def link(self, interface: str, port: int) -> Link:
        """The hand's side, in place of program.HandLink; raises DeviceError for another interface or a taken port."""
        port = port or next(self.ports)
        if interface != self.interface or port in self.links:
            raise DeviceError(f"Cannot use port {port} on {interface}.")
        self.links[port] = Link(self, port)
        return self.links[port]


class HandWire(HandNetwork):
    """A network with a hand.

    Attributes:
        hand: the simulated hand.
        faults: those of HAND_FAULTS, in both directions."""

    def __init__(self, seed: int = 0, interface: str = "lo", port: int = 11333) -> None:
        super().__init__(interface)
        self.hand, link = SimulatedHand(seed), self.link(interface, port)
        self.faults, self._stop = link.faults, clock.Event()
        job = (self.hand, link, clock.Lock(), self._stop)
        self._thread = clock.Thread(target=program.run, args=job, name="simulated hand", daemon=True)

    def __enter__(self) -> HandWire:
        super().__enter__()
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        self._stop.set()
        self._thread.join()


class Link:
    """As program.HandLink."""

    def __init__(self, network: HandNetwork, port: int) -> None:
        self.interface, self.port = network.interface, port
        self.faults = Faults(hand_faults.HAND_FAULTS)
        self.wire = hand_faults.HandWire(self.faults)
        self.hosts: list[Transport] = []
        self.commands = Packets()
        self._network = network

    def send(self, data: bytes) -> None:
        """Sends a packet to the hosts."""
        for packet in self.wire.outgoing(data, clock.monotonic()):
            for host in [] if self._network.broken else self.hosts:
                host.packets.put(packet)

    def collect(self) -> list[bytes]:
        """Returns the commands that have come since the last call."""
        found: list[bytes] = []
        while (command := self.commands.get(0.0)) is not None:
            found.append(command)
        return self.wire.incoming(found)

    def close(self) -> None:
        """Takes the hand from the network."""
        self._network.links.pop(self.port, None)


class Transport:
    """As reflex.transport.HandTransport."""

    def __init__(self, network: HandNetwork, port: int) -> None:
        self._network, self._link = network, network.links.get(port)
        self.packets = Packets()
        if self._link is not None:
            self._link.hosts.append(self)

    def receive(self, timeout: float) -> tuple[bytes, tuple[str, int]] | None:
        """Returns the next packet of the hand, and its sender; None after `timeout` [s]."""
        packet = self.packets.get(timeout)
        return None if packet is None else (packet, SOURCE)

    def send(self, data: bytes) -> None:
        """Sends a packet to the hand; raises WireFault if the interface is down."""
        if self._network.broken:
            raise WireFault(f"Cannot send to {self._network.interface}: {self._network.broken}.")
        if self._link is not None:
            self._link.commands.put(data)

    def close(self) -> None:
        """Hears nothing more; may be called twice."""
        if self._link is not None and self in self._link.hosts:
            self._link.hosts.remove(self)


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
            self._there.wait(max(min(due, deadline) - now, LEAST_S))
        return self._waiting.popleft()[1]

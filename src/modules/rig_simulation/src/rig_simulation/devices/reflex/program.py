"""The program `reflex_hand.py`: the simulated hand with its control port, and its network interface, UDP multicast with
both directions on one port.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import socket
import struct
from collections.abc import Callable
from typing import Any

from common import clock
from common.command_line import failed, parse_options, port, stop_on_signals
from common.errors import DeviceError, RigError
from rig_simulation.control_port import ControlPort, within
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.wire import GROUP, STATE_BYTES, read_command
from rig_simulation.faults.hand import HAND_FAULTS, HandWire
from rig_simulation.faults.injection import Faults, add_option, switch_all

_SIOCGIFADDR = 0x8915
_IP_MULTICAST_ALL = 49


class HandLink:
    """Sends state packets to the group and collects the commands, on a network interface such as lo; port 0 takes a
    free UDP port, see the attribute. Raises DeviceError if interface or port cannot be used, or another hand already
    sends there."""

    def __init__(self, interface: str, port: int) -> None:
        self.interface = interface
        host = _address(interface)
        group = socket.inet_aton(GROUP)
        where = socket.inet_aton(host) + struct.pack("@i", socket.if_nametoindex(interface))
        self.faults = Faults(HAND_FAULTS)
        self.wire = HandWire(self.faults)
        self._inbox = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._outbox = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if port:
                # Host and hand share the port; a free port must not be shared when it is chosen.
                self._inbox.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                self._inbox.bind((GROUP, port))
            else:
                self._inbox.bind((GROUP, 0))
                self._inbox.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._inbox.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            self._inbox.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + where)
            self._outbox.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, group + where)
            self._outbox.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            self._outbox.bind((host, 0))
        except (OSError, OverflowError) as error:
            self.close()
            raise DeviceError(f"Cannot use {GROUP}:{port} on {interface}: {error}. Use lo.") from None
        self._inbox.setblocking(False)
        self.port = self._inbox.getsockname()[1]
        self._own = self._outbox.getsockname()
        self._refuse_second_hand()

    def send(self, data: bytes) -> None:
        """Sends a packet; a packet that the network refuses is lost, as on an unplugged cable."""
        for packet in self.wire.outgoing(data, clock.monotonic()):
            with contextlib.suppress(OSError):
                self._outbox.sendto(packet, (GROUP, self.port))

    def collect(self) -> list[bytes]:
        """Returns the datagrams that others sent since the last call, in order."""
        max_datagram_bytes = 2048
        found: list[bytes] = []
        while True:
            try:
                data, source = self._inbox.recvfrom(max_datagram_bytes)
            except BlockingIOError:
                return self.wire.incoming(found)
            if source != self._own:
                found.append(data)

    def close(self) -> None:
        self._inbox.close()
        self._outbox.close()

    def _refuse_second_hand(self) -> None:
        other_hand_wait_s = 0.15
        clock.sleep(other_hand_wait_s)
        if any(len(data) == STATE_BYTES for data in self.collect()):
            self.close()
            problem = f"Another hand already sends on port {self.port} of {self.interface}"
            raise DeviceError(f"{problem}. Stop it, or choose another port.")


def _address(interface: str) -> str:
    names = [name for _, name in socket.if_nameindex()]
    if interface not in names:
        raise DeviceError(f"There is no network interface {interface!r}; choose one of {', '.join(names)}.")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        try:
            answer = fcntl.ioctl(s.fileno(), _SIOCGIFADDR, struct.pack("256s", interface.encode()))
        except OSError:
            raise DeviceError(f"The network interface {interface} has no IPv4 address; use lo.") from None
    return socket.inet_ntoa(answer[20:24])


NAME = "reflex_hand"
REQUESTS = (
    *("state", "set_load", "press", "block", "stick_encoder"),
    *("unplug_servo", "jump", "set_servo", "set_silent", "power_cycle"),
)


def main(arguments: list[str] | None = None) -> int:
    """Runs the simulated hand until it is interrupted; returns the exit code."""
    options = _options(arguments)
    stop = clock.Event()
    stop_on_signals(stop.set)
    try:
        with contextlib.closing(HandLink(options.interface, options.port)) as link:
            hand, lock = SimulatedHand(options.seed), clock.Lock()
            switch_all(link.faults, options.fault)
            with ControlPort(handlers(hand, link, lock), port=options.control_port) as control:
                print(ready_line(link, control), flush=True)
                run(hand, link, lock, stop)
    except RigError as error:
        return failed(NAME, error)
    return 0


def ready_line(link: HandLink, control: ControlPort, name: str = NAME) -> str:
    """Returns what a program prints when the hand is on the network."""
    return f"{name}: on {link.interface}, UDP port {link.port}, control port {control.host}:{control.port}"


def run(hand: SimulatedHand, link: HandLink, lock: clock.Lock, stop: clock.Event) -> None:
    """Runs the hand's cycle: measure, send the state, then execute the commands received meanwhile."""
    longest_step_s = 0.1
    before = due = clock.monotonic()
    while not stop.wait(max(0.0, due - clock.monotonic())):
        now = clock.monotonic()
        with lock:
            hand.step(min(now - before, longest_step_s))
            exchange(hand, link)
        before = now
        due = max(due + PERIOD_S, now)


def exchange(hand: SimulatedHand, link: HandLink) -> None:
    """Sends the hand's state, then executes the received commands, with the faults of the link."""
    link.wire.follow(hand)
    if not hand.silent:
        link.send(hand.packet())
    for data in link.collect():
        command = read_command(data)
        if command and not hand.silent:
            hand.handle(command)


def handlers(
    hand: SimulatedHand, link: HandLink, lock: contextlib.AbstractContextManager[bool]
) -> dict[str, Callable[..., Any]]:
    return {**{name: within(lambda: lock, getattr(hand, name)) for name in REQUESTS}, **link.faults.requests}


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="Simulated ReFlex TakkTile hand.")
    parser.add_argument("--interface", default="lo", help="network interface (default: lo)")
    parser.add_argument("--port", type=port, default=11333, help="UDP port; 0: any free one (default: 11333)")
    parser.add_argument("--control-port", type=port, default=11433, help="TCP port; 0: any free one (default: 11433)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the hand's slack, zeros and noise (default: 0)")
    add_option(parser, HAND_FAULTS)
    return parse_options(parser, arguments)

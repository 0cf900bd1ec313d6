"""The network interface of the simulated hand: UDP multicast, both directions on one port."""

from __future__ import annotations

import contextlib
import fcntl
import socket
import struct
import time

from common.errors import DeviceError
from rig_simulation.devices.reflex.wire import GROUP, STATE_BYTES
from rig_simulation.faults.hand import HAND_FAULTS, HandWire
from rig_simulation.faults.injection import Faults

OTHER_HAND_WAIT_S = 0.15
MAX_DATAGRAM_BYTES = 2048

_SIOCGIFADDR = 0x8915
_IP_MULTICAST_ALL = 49


class HandLink:
    """Sends state packets to the group and collects the commands.

    Args:
        interface: name of the network interface, such as lo.
        port: UDP port; 0 takes a free one, see the attribute `port`.

    Attributes:
        faults: those of HAND_FAULTS; may be switched at any time.
        wire: their effect.

    Raises:
        DeviceError: the interface or port cannot be used, or another hand already sends there.
    """

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
        for packet in self.wire.outgoing(data, time.monotonic()):
            with contextlib.suppress(OSError):
                self._outbox.sendto(packet, (GROUP, self.port))

    def collect(self) -> list[bytes]:
        """Returns the datagrams that others sent since the last call, in order."""
        found: list[bytes] = []
        while True:
            try:
                data, source = self._inbox.recvfrom(MAX_DATAGRAM_BYTES)
            except BlockingIOError:
                return self.wire.incoming(found)
            if source != self._own:
                found.append(data)

    def close(self) -> None:
        """Closes the sockets; may be called twice."""
        self._inbox.close()
        self._outbox.close()

    def _refuse_second_hand(self) -> None:
        time.sleep(OTHER_HAND_WAIT_S)
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

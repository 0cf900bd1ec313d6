"""The UDP multicast sockets between host and hand: both directions on one group and port, on one named interface.
Drops the host's own packets, which come back on `lo`, and nothing else."""

from __future__ import annotations

import contextlib
import fcntl
import socket
import struct

from reflex.codec import GROUP
from reflex.errors import WireFault

LOOPBACK = "lo"  # the interface of the simulated hand: no real one is on it


_SIOCGIFADDR = 0x8915
_IP_MULTICAST_ALL = 49
_INTERFACE_REQUEST = struct.Struct("256s")


class HandTransport:
    """Sends to and receives from the hand on one interface, such as eth0 or lo; hand and host use the same port.
    Raises WireFault if there is no such interface, it has no IPv4 address, or the port is taken."""

    def __init__(self, interface: str, port: int) -> None:
        self._name = f"{GROUP}:{port} on {interface}"
        self._to = (GROUP, port)
        address = socket.inet_aton(interface_address(interface))
        self._receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            # Like the kernel's ip_mreqn; the index decides where two interfaces share an address.
            where = address + struct.pack("@i", socket.if_nametoindex(interface))
            self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            # Without this a socket also hears what other programs joined, such as a real hand beside a simulated one.
            self._receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            self._receiver.bind((GROUP, port))
            self._receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + where)
            self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(GROUP) + where)
            self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
            self._sender.bind((socket.inet_ntoa(address), 0))
            self._sender.setblocking(False)
        except OSError as error:
            self.close()
            raise WireFault(f"Cannot use the multicast group {self._name}: {error}.") from None
        self._own = self._sender.getsockname()

    def receive(self, timeout: float) -> tuple[bytes, tuple[str, int]] | None:
        """Returns the next datagram and its sender, or None after `timeout` [s] or for a packet of our own; raises
        WireFault if the interface is gone."""
        max_datagram_bytes = 2048
        self._receiver.settimeout(timeout)
        try:
            data, source = self._receiver.recvfrom(max_datagram_bytes)
        except socket.timeout:
            return None
        except OSError as error:
            raise WireFault(f"Cannot receive from {self._name}: {error}.") from None
        return None if source == self._own else (data, source)

    def send(self, data: bytes) -> None:
        """Sends a packet to the hand; raises a WireFault if the interface is down or gone."""
        try:
            self._sender.sendto(data, self._to)
        except OSError as error:
            raise WireFault(f"Cannot send to {self._name}: {error}.") from None

    def close(self) -> None:
        """Closes both sockets; may be called twice."""
        self._receiver.close()
        self._sender.close()


def interface_address(name: str) -> str:
    """Returns the IPv4 address of an interface; raises WireFault if there is no such interface, or it has no IPv4
    address, and lists those that could be used."""
    addresses = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        for _, other in socket.if_nameindex():
            addresses[other] = ""
            with contextlib.suppress(OSError):
                answer = fcntl.ioctl(s.fileno(), _SIOCGIFADDR, _INTERFACE_REQUEST.pack(other.encode()))
                addresses[other] = socket.inet_ntoa(answer[20:24])
    if addresses.get(name):
        return addresses[name]
    usable = ", ".join(sorted(other for other, address in addresses.items() if address)) or "none"
    what = "has no IPv4 address" if name in addresses else "does not exist"
    raise WireFault(f"The network interface {name!r} {what}; interfaces with an IPv4 address: {usable}.")

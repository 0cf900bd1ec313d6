"""A TUN device between this network and itself: what is sent to its far address is handed over as IPv4 packets. A
connection to the far address leaves by the device. A packet that is handed back with its two addresses exchanged
arrives at the near address, from the far one: so both ends of a real TCP connection are in one network, and its packets
pass by here. The sums of the headers stay right, as they do not depend on the order of the two addresses."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
from pathlib import Path

from tools.own_network import bring_up

TUN_SET, TUN, NO_INFO = 0x400454CA, 0x0001, 0x1000
SET_ADDRESS, SET_MASK, SET_MTU = 0x8916, 0x891C, 0x8922
MTU = 1500
NETMASK, HOST_MASK = "255.255.255.252", "255.255.255.255"


class Tun:
    """The device, until it is closed; needs a network of its own, see `unshare`. Addresses in 127.0.0.0/8 are as good
    as others: who listens on loopback alone, listens there. Raises OSError: this process may not make one."""

    def __init__(self, name: str, near: str) -> None:
        self._file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        try:
            fcntl.ioctl(self._file, TUN_SET, struct.pack("16sH22x", name.encode(), TUN | NO_INFO))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
                if near.startswith("127."):
                    # Elsewhere than the device the kernel would look for the whole of 127.0.0.0/8 on `lo`.
                    _set_address(any_socket, SET_MASK, "lo", HOST_MASK)
                    Path(f"/proc/sys/net/ipv4/conf/{name}/route_localnet").write_text("1")
                _set_address(any_socket, SET_ADDRESS, name, near)
                _set_address(any_socket, SET_MASK, name, NETMASK)
                fcntl.ioctl(any_socket, SET_MTU, struct.pack("16si20x", name.encode(), MTU))
            bring_up(name)
        except OSError:
            os.close(self._file)
            raise

    def fileno(self) -> int:
        """For selectors."""
        return self._file

    def read(self) -> bytes | None:
        """Returns a packet, or None if nothing waits."""
        try:
            return os.read(self._file, 65536)
        except BlockingIOError:
            return None

    def write(self, packet: bytes) -> None:
        """Hands a packet over."""
        os.write(self._file, packet)

    def close(self) -> None:
        """Removes the device."""
        os.close(self._file)


def _set_address(any_socket: socket.socket, request: int, name: str, address: str) -> None:
    packed = struct.pack("16sHH4s16x", name.encode(), socket.AF_INET, 0, socket.inet_aton(address))
    fcntl.ioctl(any_socket, request, packed)

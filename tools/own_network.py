"""A network of a program's own (`unshare --net`), whose devices are down at first."""

from __future__ import annotations

import fcntl
import socket
import struct

GET_FLAGS, SET_FLAGS, IFF_UP = 0x8913, 0x8914, 1
"""netdevice(7)."""


def bring_up(device: str = "lo") -> None:
    """Switches a network device on, without which nothing can connect; if it is on already, anybody may call this.
    Raises OSError if the device is off and this process may not change it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        answer = fcntl.ioctl(any_socket, GET_FLAGS, struct.pack("16sH22x", device.encode(), 0))
        flags = struct.unpack_from("16sH", answer)[1]
        if not flags & IFF_UP:
            fcntl.ioctl(any_socket, SET_FLAGS, struct.pack("16sH22x", device.encode(), flags | IFF_UP))

"""The TCP connections of another process with their options, seen through duplicates of its descriptors; and one that
nobody reads."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import socket
import struct
import xmlrpc.client
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import rospy

PIDFD_OPEN, PIDFD_GETFD = 434, 438  # system calls, on every architecture


class Connection(NamedTuple):
    """A connection: the ports of its two ends, and whether small packets leave at once (TCP_NODELAY)."""

    port: int
    peer_port: int
    no_delay: bool


def connections(pid: int) -> dict[int, Connection]:
    """Returns the TCP connections of a process by descriptor; OSError: this process may not look."""
    found = {}
    libc = ctypes.CDLL(None, use_errno=True)
    pidfd = libc.syscall(PIDFD_OPEN, pid, 0)
    if pidfd < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    try:
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):
                if os.readlink(entry).startswith("socket:"):
                    connection = _connection(libc, pidfd, int(entry.name))
                    if connection is not None:
                        found[int(entry.name)] = connection
    finally:
        os.close(pidfd)
    return found


def _connection(libc: ctypes.CDLL, pidfd: int, number: int) -> Connection | None:
    """Returns the connection of a descriptor; None if the descriptor is not a TCP connection. No Python socket is made
    of the duplicate: it would change the mode of the other process's socket, too."""
    own = libc.syscall(PIDFD_GETFD, pidfd, number, 0)
    if own < 0:
        error = ctypes.get_errno()
        if error == errno.EBADF:  # it was closed meanwhile
            return None
        raise OSError(error, os.strerror(error))
    try:
        ends = [_port(call, own) for call in (libc.getsockname, libc.getpeername)]
        value, size = ctypes.c_int(), ctypes.c_uint(4)
        option = (socket.IPPROTO_TCP, socket.TCP_NODELAY, ctypes.byref(value), ctypes.byref(size))
        if None in ends or libc.getsockopt(own, *option):
            return None
        return Connection(*ends, bool(value.value))
    finally:
        os.close(own)


def _port(call: Callable[..., int], own: int) -> int | None:
    address, size = ctypes.create_string_buffer(128), ctypes.c_uint(128)
    failed = call(own, address, ctypes.byref(size))
    family, port = struct.unpack("=H2s", address.raw[:4])
    return None if failed or family != socket.AF_INET else int.from_bytes(port, "big")


class DeafSubscriber:
    """A subscriber of a topic with a small buffer, which never reads a message."""

    def __init__(self, topic: str, node: str) -> None:
        master = xmlrpc.client.ServerProxy(os.environ["ROS_MASTER_URI"])
        uri = master.lookupNode(rospy.get_name(), f"/{node}")[2]
        _, _, (_, host, port) = xmlrpc.client.ServerProxy(uri).requestTopic("/deaf", topic, [["TCPROS"]])
        self._connection = socket.socket()
        self._connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        self._connection.connect((host, port))
        fields = [f"callerid=/deaf_{os.getpid()}", f"topic={topic}", "md5sum=*", "type=*", "tcp_nodelay=1"]
        header = b"".join(len(field).to_bytes(4, "little") + field.encode() for field in fields)
        self._connection.sendall(len(header).to_bytes(4, "little") + header)

    def close(self) -> None:
        self._connection.close()

"""TCP of one machine in this process and in virtual time.

    with Network(control_port, transport) as network:  # modules that `import socket`
        listener = network.sockets.create_server(("127.0.0.1", 0))
        ...

The modules run unchanged: their names `socket` and `time` are stand-ins meanwhile. As with the kernel's sockets, data
comes in order and up to DELAY_S later, and a port takes connections also while its program stands still.
"""

from __future__ import annotations

import contextlib
import errno
import io
import itertools
import os
import socket
from collections import deque
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from common import clock
from simulated.scheduler import active, is_over

DELAY_S = 0.0005
FIRST_PORT = 40000


class Network(contextlib.AbstractContextManager):
    """The sockets of some modules.

    Attributes:
        sockets: what these modules have in place of the module socket.
    """

    def __init__(self, *modules: ModuleType) -> None:
        self._modules, self._patch = modules, pytest.MonkeyPatch()
        self.sockets: Any = _Sockets(self)
        self.listeners: dict[int, Socket] = {}
        self.numbers = itertools.count(FIRST_PORT)

    def __enter__(self) -> Network:
        for module in self._modules:
            self._patch.setattr(module, "socket", self.sockets)
            if hasattr(module, "time"):
                self._patch.setattr(module, "time", SimpleNamespace(monotonic=lambda: clock.monotonic()))
        return self

    def __exit__(self, *_: object) -> None:
        self._patch.undo()

    def free_port(self) -> int:
        """A port that nobody listens on."""
        return next(self.numbers)


class Pipe:
    """Data on its way in one direction."""

    def __init__(self) -> None:
        self._data: deque[tuple[float, Any]] = deque()
        self._there = clock.Event()
        self.closed = False

    def put(self, data: Any) -> None:
        """Sends it."""
        if not is_over():
            due = clock.monotonic() + active().drawn(DELAY_S)
            self._data.append((max(due, self._data[-1][0]) if self._data else due, data))
            self._there.set()

    def unread(self, data: Any) -> None:
        """Puts it back in front."""
        self._data.appendleft((0.0, data))

    def close(self) -> None:
        """Nothing follows."""
        self.closed = True
        self._there.set()

    def get(self, timeout: float | None) -> Any:
        """Returns what comes next, b"" at the end; raises socket.timeout."""
        deadline = float("inf") if timeout is None else clock.monotonic() + timeout
        while True:
            now, due = clock.monotonic(), self._data[0][0] if self._data else float("inf")
            if due <= now:
                return self._data.popleft()[1]
            if self.closed and not self._data:
                return b""
            if now >= deadline:
                raise socket.timeout("timed out")
            if self._data:
                clock.sleep(min(due, deadline) - now)
            else:
                self._there.clear()
                self._there.wait(None if timeout is None else deadline - now)


class Socket:
    """A TCP socket, as far as the project's modules use one."""

    def __init__(self, network: Network, family: int = socket.AF_INET, kind: int = socket.SOCK_STREAM) -> None:
        assert kind == socket.SOCK_STREAM
        self._network, self._timeout, self._address = network, None, ("127.0.0.1", 0)
        self.incoming, self.outgoing = Pipe(), Pipe()
        self._files, self._closing = 0, False

    def setsockopt(self, *_: Any) -> None:
        """Has no effect."""

    def settimeout(self, seconds: float | None) -> None:
        """Sets how long a call may wait [s]."""
        self._timeout = seconds

    def getsockname(self) -> tuple[str, int]:
        """The own address."""
        return self._address

    def bind(self, address: tuple[str, int]) -> None:
        """Takes a port; 0: a free one."""
        host, port = address
        if not 0 <= port <= 65535:
            raise OverflowError("bind(): port must be 0-65535.")
        if port in self._network.listeners:
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
        self._address = host, port or self._network.free_port()

    def listen(self, _backlog: int = 0) -> None:
        """Takes connections from now on."""
        self._network.listeners[self._address[1]] = self

    def accept(self) -> tuple[Socket, tuple[str, int]]:
        """Waits for a connection."""
        accepted = self.incoming.get(self._timeout)
        if accepted == b"":
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        return accepted, accepted.getsockname()

    def connect(self, address: tuple[str, int]) -> None:
        """Connects to a port."""
        clock.sleep(active().drawn(DELAY_S))
        listener = self._network.listeners.get(address[1])
        if listener is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
        other = Socket(self._network)
        other.incoming, other.outgoing, other._address = self.outgoing, self.incoming, address
        listener.incoming.put(other)

    def sendall(self, data: bytes) -> None:
        """Sends bytes."""
        if self.outgoing.closed:
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))
        self.outgoing.put(bytes(data))

    def recv(self, size: int) -> bytes:
        """Waits for bytes; b"" at the end."""
        data = self.incoming.get(self._timeout)
        if len(data) > size:
            self.incoming.unread(data[size:])
        return data[:size]

    def makefile(self, mode: str) -> Any:
        """A file of the connection, which stays open as long as the file."""
        self._files += 1
        raw: Any = _Raw(self)
        return io.BufferedRWPair(raw, raw) if "w" in mode else io.BufferedReader(raw)

    def shutdown(self, how: int) -> None:
        """Ends one or both directions."""
        self.outgoing.close()
        if how != socket.SHUT_WR:
            self._leave()

    def close(self) -> None:
        """Ends the connection, or frees the port."""
        self._closing = True
        if not self._files:
            self.outgoing.close()
            self._leave()

    def file_closed(self) -> None:
        """One of its files is closed."""
        self._files -= 1
        if self._closing:
            self.close()

    def _leave(self) -> None:
        self.incoming.close()
        if self._network.listeners.get(self._address[1]) is self:
            del self._network.listeners[self._address[1]]

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Raw(io.RawIOBase):
    def __init__(self, of: Socket) -> None:
        self._of = of

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        data = self._of.recv(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def write(self, data: Any) -> int:
        self._of.sendall(bytes(data))
        return len(data)

    def close(self) -> None:
        if not self.closed:
            super().close()
            self._of.file_closed()


class _Sockets:
    """Stands for the module socket; what it lacks is the module's."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def __getattr__(self, name: str) -> Any:
        return getattr(socket, name)

    def socket(self, *kind: int) -> Socket:
        return Socket(self._network, *kind)

    def create_connection(self, address: tuple[str, int], timeout: float | None = None) -> Socket:
        made = Socket(self._network)
        made.settimeout(timeout)
        made.connect(address)
        return made

    def create_server(self, address: tuple[str, int], **_: Any) -> Socket:
        made = Socket(self._network)
        made.bind(address)
        made.listen()
        return made

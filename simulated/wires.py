"""TCP in virtual time: the product's own transports, servers and control ports on sockets in memory.

    wires = Wires(scheduler)
    wires.stand_in(patch)  # for socket, select, selectors and threads in the modules of MODULES

A connection has two ways, which a test may worsen: `wires.connections[-1].up.stalls = [(begin, end)]`. What a thread
opens belongs to its group, and closes with it. As by the kernel, a connection is accepted, and bytes are kept, for a
group whose threads stand still.
"""

from __future__ import annotations

import errno
import io
import ipaddress
import math
import os
import random
import select
import selectors
import socket
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from itertools import count
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

import kst.transport
import leap_motion.transport
import rig_simulation.control_port
import rig_simulation.devices.sunrise.server
from common import clock
from simulated.scheduler import Scheduler, is_over

MODULES = (
    *(kst.transport, leap_motion.transport),
    *(rig_simulation.control_port, rig_simulation.devices.sunrise.server),
)
DELAY_S = 2e-4  # of a packet on this machine
RTO_S = 0.2  # TCP repeats a lost packet after this time [s],
FAST = 3  # or, if so many later ones arrive, at once
LEAST_S = 1e-6  # shortest wait: a shorter one may be lost to rounding
FIRST_PORT = 40000  # of those that a listener gets for port 0


class Way:
    """One direction of a TCP stream: packets arrive in order after `delay` +- `jitter` [s]; an empty one is its end.

    A packet is lost with the probability `loss`; `repaired` says whether later ones betray that, as they do in TCP, or
    the stream stalls for RTO_S in any case. With `nagle` bytes wait, and go together, until the last ones are
    confirmed.

    Attributes:
        stalls: from when to when nothing arrives [s].
        sent: called with each packet and its time [s].
    """

    def __init__(self, rng: random.Random) -> None:
        self.stalls: list[tuple[float, float]] = []
        self.sent: Callable[[bytes, float], None] = lambda data, now: None
        self.nagle = False
        self._rng = rng
        self._packets: deque[list[Any]] = deque()  # each with the time of its arrival, and of that of its repetition
        self._arrived, self._later, self._confirmed, self._held_until = 0.0, 0, 0.0, 0.0
        self.worsen()

    def worsen(self, delay: float = DELAY_S, jitter: float = 0.0, loss: float = 0.0, repaired: bool = True) -> None:
        """Changes what becomes of the packets that are sent from now on."""
        self.delay, self.jitter, self.loss, self.repaired = delay, jitter, loss, repaired

    def put(self, now: float, data: bytes) -> None:
        """Takes a packet."""
        self.sent(data, now)
        if now < self._held_until:  # the last packet has not left yet
            if data:
                self._packets[-1][2] += data
                return
            now = self._held_until
        elif self.nagle and now < self._confirmed:
            now = self._held_until = self._confirmed
        delay = self.delay + self._rng.uniform(-self.jitter, self.jitter)
        again = 0.0
        lost = [packet for packet in self._packets if packet[1]]
        if lost:
            self._later += 1
            if self.repaired and self._later == FAST:
                lost[0][1] = min(lost[0][1], now + 3.0 * delay)
        elif self._rng.random() < self.loss:
            again, self._later = now + RTO_S + delay, 0
        self._packets.append([now + delay, again, data])
        self._confirmed = max(now + delay, again) + self.delay

    def due(self) -> float:
        """When the next packet arrives [s]; infinity if none is under way."""
        if not self._packets:
            return math.inf
        due = max(*self._packets[0][:2], self._arrived)
        for begin, end in self.stalls:
            due = end if begin <= due < end else due
        return due

    def take(self, now: float) -> list[bytes]:
        """The packets that have arrived."""
        packets = []
        while self.due() <= now:
            self._arrived = self.due()
            packets.append(self._packets.popleft()[2])
        return packets

    @property
    def is_empty(self) -> bool:
        """Whether no bytes are under way."""
        return not any(packet[2] for packet in self._packets)


class Connection(NamedTuple):
    """One connection, as the client sees it."""

    address: tuple[str, int]
    up: Way
    down: Way


class Wires:
    """The sockets of a simulation.

    Attributes:
        connections: all that were made, in this order.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler
        self.connections: list[Connection] = []
        self._listeners: dict[int, Socket] = {}
        self._of_group: dict[str, list[Socket]] = {}
        self._ports = count(FIRST_PORT)

    def stand_in(self, patch: pytest.MonkeyPatch) -> None:
        """Gives them to the modules that use sockets."""
        standing = {
            "socket": _Module(socket, socket=lambda *_: Socket(self), create_connection=self.connect),
            "select": _Module(select, poll=lambda: Poll(self)),
            "selectors": _Module(selectors, DefaultSelector=lambda: Selector(self)),
            "threading": clock,
            "time": clock,
            "ThreadPoolExecutor": _AtOnce,
        }
        for module in MODULES:
            for name, own in standing.items():
                if hasattr(module, name):
                    patch.setattr(module, name, own)
        patch.setattr(kst.transport.KstTransport, "monotonic", staticmethod(lambda: clock.monotonic()))

    def connect(self, address: tuple[str, int], timeout: float | None = None, *_: object) -> Socket:
        """As socket.create_connection; other machines do not answer."""
        host, port = address
        if host != "localhost" and not ipaddress.ip_address(host).is_loopback:
            clock.sleep(math.inf if timeout is None else timeout)
            raise TimeoutError("timed out")
        clock.sleep(2.0 * DELAY_S)
        listener = self._listeners.get(port)
        if listener is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
        near, far = Socket(self), Socket(self, listener.group)
        near.address, far.address = (host, next(self._ports)), listener.address
        near.join(far)
        self.connections.append(Connection((host, port), far.incoming, near.incoming))
        listener.take(far)
        return near

    def way(self) -> Way:
        """A way of a new connection."""
        return Way(random.Random(self.scheduler.drawn(1.0)))

    def listen(self, listener: Socket, host: str, port: int) -> tuple[str, int]:
        """Gives a port to a listener; returns the address."""
        if port in self._listeners:
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
        port = port or next(self._ports)
        self._listeners[port] = listener
        return host, port

    def free(self, address: tuple[str, int]) -> None:
        """Nobody listens there any more."""
        del self._listeners[address[1]]

    def add(self, opened: Socket) -> None:
        """Notes whose it is."""
        self._of_group.setdefault(opened.group, []).append(opened)

    def end(self, group: str) -> None:
        """Closes the sockets of a group, as the kernel does with those of a process."""
        for each in self._of_group.pop(group, []):
            each.really_close()

    def wait(self, ready_at: Callable[[], float], watched: Iterable[Socket], deadline: float) -> bool:
        """Waits until the time that `ready_at` tells, or the deadline [s]; returns whether it came.

        The time may change as one of the sockets does.
        """
        changed = clock.Event()
        watched = list(watched)
        for each in watched:
            each.watchers.append(changed)
        try:
            while ready_at() > self.scheduler.now:
                if self.scheduler.now >= deadline:
                    return False
                until = min(ready_at(), deadline)
                changed.clear()
                changed.wait(None if math.isinf(until) else max(until - self.scheduler.now, LEAST_S))
            return True
        finally:
            for each in watched:
                each.watchers.remove(changed)


class Socket:
    """As socket.socket, as far as MODULES use it.

    Attributes:
        group: whose it is.
        address: its own.
        incoming: the way on which bytes come to it.
        watchers: events that are set at each change.
    """

    def __init__(self, wires: Wires, group: str | None = None) -> None:
        self.group = wires.scheduler.current.group if group is None else group
        self.address = ("0.0.0.0", 0)
        self.incoming = wires.way()
        self.watchers: list[clock.Event] = []
        self._wires, self._scheduler = wires, wires.scheduler
        self._peer: Socket | None = None
        self._timeout: float | None = None
        self._received, self._ended = b"", False
        self._reset = self._shut = self._said_end = self._closing = self._closed = self._resets = False
        self._listens, self._waiting, self._files = False, deque[Socket](), 0
        wires.add(self)

    def join(self, peer: Socket) -> None:
        """Connects two new sockets."""
        self._peer, peer._peer = peer, self

    def take(self, peer: Socket) -> None:
        """A listener gets a new connection."""
        self._waiting.append(peer)
        self._changed()

    def readable_at(self) -> float:
        """When `recv` or `accept` need not wait [s]."""
        if self._waiting or self._received or self._ended or self._reset or self._shut or self._closed:
            return -math.inf
        return self.incoming.due()

    # As socket.socket.

    def setblocking(self, blocks: bool) -> None:
        """Waits, or does not."""
        self._timeout = None if blocks else 0.0

    def settimeout(self, seconds: float | None) -> None:
        """How long it waits [s]."""
        self._timeout = seconds

    def setsockopt(self, level: int, option: int, value: Any) -> None:
        """Of the options those work that are felt on the way."""
        if (level, option) == (socket.IPPROTO_TCP, socket.TCP_NODELAY) and self._peer is not None:
            self._peer.incoming.nagle = not value
        self._resets |= (level, option) == (socket.SOL_SOCKET, socket.SO_LINGER)

    def bind(self, address: tuple[str, int]) -> None:
        """Takes a port."""
        self.address, self._listens = self._wires.listen(self, *address), True

    def listen(self, backlog: int = 0) -> None:
        """Has done so from `bind` on."""

    def getsockname(self) -> tuple[str, int]:
        """Its own address."""
        return self.address

    def getpeername(self) -> tuple[str, int]:
        """The address of the other end."""
        if self._peer is None:
            raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))
        return self._peer.address

    def accept(self) -> tuple[Socket, tuple[str, int]]:
        """The next connection."""
        self._wait()
        if not self._waiting:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        accepted = self._waiting.popleft()
        return accepted, accepted.getpeername()

    def recv(self, size: int) -> bytes:
        """What has come, at most `size` bytes; nothing at the end."""
        self._wait()
        if self._reset:
            raise ConnectionResetError(errno.ECONNRESET, os.strerror(errno.ECONNRESET))
        for packet in self.incoming.take(self._scheduler.now):
            self._received += packet
            self._ended |= not packet
        data, self._received = self._received[:size], self._received[size:]
        return data

    def send(self, data: bytes) -> int:
        """Takes all of it; there is always room."""
        if self._closed or self._peer is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        if self._reset or self._said_end:
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))
        if self._peer._closed:
            self._reset = True  # the answer of a kernel to what no program reads
        else:
            self._peer.incoming.put(self._scheduler.now, bytes(data))
            self._peer._changed()
        self._scheduler.maybe_give_way()
        return len(data)

    def sendall(self, data: bytes) -> None:
        """Sends all of it."""
        self.send(data)

    def shutdown(self, how: int) -> None:
        """Ends what it sends, or both directions."""
        if self._peer is None and not self._listens:
            raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))
        if how == socket.SHUT_RDWR:
            self._shut = True
            self._changed()
        self._say_end()

    def makefile(self, mode: str) -> io.BufferedIOBase:
        """A file of it, until whose end it stays open."""
        self._files += 1
        raw = _File(self)
        return io.BufferedReader(raw) if mode == "rb" else io.BufferedRWPair(raw, _File(self, own=False))

    def close(self) -> None:
        """Closes it, or lets the last of its files do so."""
        self._closing = True
        if not self._files:
            self.really_close()

    def really_close(self) -> None:
        """Bytes that nobody has read reset the connection."""
        if self._closed or is_over():
            return
        self._closed = True
        if self._listens:
            self._wires.free(self.address)
            for each in self._waiting:
                each._resets = True
                each.really_close()
        elif self._peer is not None:
            if (self._resets or self._received or not self.incoming.is_empty) and not self._peer._closed:
                self._peer._reset = True
                self._peer._changed()
            self._say_end()
        self._changed()

    def file_closed(self) -> None:
        """One of its files has been closed."""
        self._files -= 1
        if self._closing:
            self.close()

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _say_end(self) -> None:
        if not self._said_end and self._peer is not None:
            self._said_end = True
            self._peer.incoming.put(self._scheduler.now, b"")
            self._peer._changed()

    def _wait(self) -> None:
        now, timeout = self._scheduler.now, self._timeout
        deadline = math.inf if timeout is None else now + timeout
        if not self._wires.wait(self.readable_at, [self], deadline):
            raise (
                BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
                if timeout == 0.0
                else TimeoutError("timed out")
            )
        if self._closed:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    def _changed(self) -> None:
        for each in self.watchers:
            each.set()


class Poll:
    """As select.poll; there is always room to write."""

    def __init__(self, wires: Wires) -> None:
        self._wires = wires
        self._events: dict[Socket, int] = {}

    def register(self, watched: Socket, events: int) -> None:
        """Looks at a socket, too."""
        self._events[watched] = events

    def poll(self, milliseconds: float | None = None) -> list[tuple[Socket, int]]:
        """Those that are ready."""
        now = self._wires.scheduler.now
        deadline = math.inf if milliseconds is None else now + milliseconds / 1000.0

        def ready_at() -> float:
            times = (-math.inf if wanted & select.POLLOUT else s.readable_at() for s, wanted in self._events.items())
            return min(times, default=math.inf)

        self._wires.wait(ready_at, self._events, deadline)
        now = self._wires.scheduler.now
        return [(s, wanted) for s, wanted in self._events.items() if wanted & select.POLLOUT or s.readable_at() <= now]


class Selector:
    """As selectors.DefaultSelector, for reading."""

    def __init__(self, wires: Wires) -> None:
        self._wires = wires
        self._keys: dict[Socket, SimpleNamespace] = {}

    def register(self, watched: Socket, events: int) -> None:
        """Looks at a socket, too."""
        self._keys[watched] = SimpleNamespace(fileobj=watched)

    def unregister(self, watched: Socket) -> None:
        """Looks at it no longer."""
        del self._keys[watched]

    def get_map(self) -> dict[Socket, SimpleNamespace]:
        """What it looks at."""
        return self._keys

    def select(self, timeout: float) -> list[tuple[SimpleNamespace, int]]:
        """Those that can be read."""
        deadline = self._wires.scheduler.now + timeout
        self._wires.wait(lambda: min((s.readable_at() for s in self._keys), default=math.inf), self._keys, deadline)
        now = self._wires.scheduler.now
        return [(key, selectors.EVENT_READ) for s, key in self._keys.items() if s.readable_at() <= now]

    def close(self) -> None:
        """Looks at nothing."""
        self._keys.clear()


class _Module:
    """A module with some names of its own."""

    def __init__(self, module: Any, **own: Any) -> None:
        self._module = module
        self.__dict__.update(own)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


class _File(io.RawIOBase):
    """A socket as a file; the half for writing of a pair is not its `own`."""

    def __init__(self, underlying: Socket, own: bool = True) -> None:
        self._socket, self._own = underlying, own

    def readable(self) -> bool:
        """Yes."""
        return True

    def writable(self) -> bool:
        """Yes."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Reads what has come."""
        data = self._socket.recv(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def write(self, data: Any) -> int:
        """Sends it."""
        return self._socket.send(bytes(data))

    def close(self) -> None:
        """Lets go of the socket."""
        if not self.closed:
            super().close()
            if self._own:
                self._socket.file_closed()


class _AtOnce:
    """As ThreadPoolExecutor: what is computed takes no time."""

    def __init__(self, *_: object) -> None:
        pass

    def submit(self, job: Callable[..., Any], *args: Any) -> Future[Any]:
        """Does the job."""
        done: Future[Any] = Future()
        try:
            done.set_result(job(*args))
        except Exception as error:
            done.set_exception(error)
        return done

    def shutdown(self, wait: bool = True) -> None:
        """Has nothing to end."""

"""TCP in virtual time: the product's own transports, servers and control ports on sockets in memory.

    with virtual_wires() as wires:  # for socket, select, selectors, asyncio's loop and threads in MODULES
        ...

A connection has two ways, which a test may worsen: `wires.connections[-1].up.stalls = [(begin, end)]`. What a thread
opens belongs to its group, and closes with it. As by the kernel, a connection is accepted, and bytes are kept, for a
group whose threads stand still."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import io
import ipaddress
import math
import os
import random
import select
import selectors
import socket
import struct
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from itertools import count
from typing import Any, NamedTuple

import pytest
import websockets.sync.client
import websockets.sync.connection
import websockets.sync.messages
import websockets.sync.server
import websockets.sync.utils

import kst.transport
import leap_motion.headset.transport
import leap_motion.service.server
import leap_motion.service.socket_service
import leap_motion.transport
import rig_simulation.control_port
import rig_simulation.devices.leap.server
import rig_simulation.devices.sunrise.server
from common import clock
from simulated.clock import virtual_time
from simulated.event_loop import EventLoop, Outcome
from simulated.scheduler import Killed, Scheduler, is_over

MODULES = (
    *(kst.transport, leap_motion.transport, leap_motion.service.server, leap_motion.headset.transport),
    leap_motion.service.socket_service,
    *(rig_simulation.control_port, rig_simulation.devices.sunrise.server, rig_simulation.devices.leap.server),
    *(websockets.sync.client, websockets.sync.connection, websockets.sync.messages),
    *(websockets.sync.server, websockets.sync.utils),
)
DELAY_S = 2e-4  # of a packet on this machine
RTO_S = 0.2  # TCP repeats a lost packet after this time [s],
FAST = 3  # or, if so many later ones arrive, at once
LEAST_S = 1e-6  # shortest wait: a shorter one may be lost to rounding
FIRST_PORT = 40000  # of those that a listener gets for port 0
FIRST_NUMBER = 10**6  # of a socket; no file of this process has one as high
OWN_ADDRESSES = ("", "localhost", "0.0.0.0", "::")


class Way:
    """One direction of a TCP stream: packets arrive in order after `delay` +- `jitter` [s]; an empty one is its end.

    A packet is lost with the probability `loss`; `repaired` says whether later ones betray that, as they do in TCP, or
    the stream stalls for RTO_S in any case. With `nagle` bytes wait, and go together, until the last ones are
    confirmed. The fraction `reordered` of the packets skips the delay, and waits for those before.

    Attributes:
        lost: packets so far.
        stalls: from when to when nothing arrives [s].
        room: how many bytes it takes that nobody has read.
        unread: how many there are.
        sent: called with each packet and its time [s]."""

    def __init__(self, rng: random.Random) -> None:
        self.changed: Callable[[], None] = lambda: None  # called where stalls or room are set
        self.stalls: list[tuple[float, float]] = []
        self.sent: Callable[[bytes, float], None] = lambda data, now: None
        self.nagle, self.lost = False, 0
        self.room, self.unread = math.inf, 0
        self._rng = rng
        self._packets: deque[list[Any]] = deque()  # each with the time of its arrival, and of that of its repetition
        self._arrived, self._later, self._confirmed, self._held_until = 0.0, 0, 0.0, 0.0
        self.worsen()

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        if name in ("stalls", "room"):
            self.changed()

    def worsen(
        self,
        delay: float = DELAY_S,
        jitter: float = 0.0,
        loss: float = 0.0,
        repaired: bool = True,
        reordered: float = 0.0,
    ) -> None:
        """Changes what becomes of the packets that are sent from now on."""
        self.delay, self.jitter, self.loss, self.repaired, self.reordered = delay, jitter, loss, repaired, reordered

    def put(self, now: float, data: bytes) -> None:
        """Takes a packet."""
        self.sent(data, now)
        self.unread += len(data)
        if now < self._held_until:  # the last packet has not left yet
            if data:
                self._packets[-1][2] += data
                return
            now = self._held_until
        elif self.nagle and now < self._confirmed:
            now = self._held_until = self._confirmed
        delay = self.delay + self._rng.uniform(-self.jitter, self.jitter)
        if self.reordered and self._rng.random() < self.reordered:
            delay = min(delay, DELAY_S)
        again = 0.0
        lost = [packet for packet in self._packets if packet[1]]
        if lost:
            self._later += 1
            if self.repaired and self._later == FAST:
                lost[0][1] = min(lost[0][1], now + 3.0 * delay)
        elif self._rng.random() < self.loss:
            again, self._later = now + RTO_S + delay, 0
            self.lost += 1
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
        on_connect: called with each new one.
        client_address: where new ones come from."""

    def __init__(self, scheduler: Scheduler) -> None:
        self.client_address = "127.0.0.1"
        self.scheduler = scheduler
        self.connections: list[Connection] = []
        self.on_connect: Callable[[Connection], None] = lambda connection: None
        self._listeners: dict[int, Socket] = {}
        self._of_group: dict[str, list[Socket]] = {}
        self._ports, self._numbers = count(FIRST_PORT), count(FIRST_NUMBER)
        self._by_number: weakref.WeakValueDictionary[int, Socket] = weakref.WeakValueDictionary()
        self.files: weakref.WeakSet[_File] = weakref.WeakSet()

    def stand_in(self, patch: pytest.MonkeyPatch) -> None:
        """Gives them to the modules that use sockets."""
        standing = {
            "socket": _Module(
                socket,
                **{"socket": lambda *_: Socket(self), "create_connection": self.connect, "create_server": self.serve},
            ),
            "select": _Module(select, poll=lambda: Poll(self)),
            "selectors": _Module(selectors, DefaultSelector=self.selector),
            "asyncio": _Module(asyncio, new_event_loop=lambda: EventLoop(self), run_coroutine_threadsafe=Outcome),
            "os": _Module(os, pipe=self.pair, write=lambda file, data: file.send(data)),
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
        near.address, far.address = (self.client_address, next(self._ports)), (host, listener.address[1])
        near.join(far)
        near.settimeout(timeout)
        self.connections.append(Connection((host, port), far.incoming, near.incoming))
        self.on_connect(self.connections[-1])
        listener.take(far)
        return near

    def serve(self, address: tuple[str, int], **_: object) -> Socket:
        """As socket.create_server."""
        listener = Socket(self)
        listener.bind(address)
        return listener

    def pair(self) -> tuple[Socket, Socket]:
        """As socket.socketpair: what one of them sends is there at once."""
        pair = Socket(self), Socket(self)
        pair[0].join(pair[1])
        for each in pair:
            each.incoming.worsen(delay=0.0)
        return pair

    def selector(self) -> Selector:
        """As selectors.DefaultSelector."""
        return Selector(self)

    def way(self) -> Way:
        """A way of a new connection."""
        return Way(random.Random(self.scheduler.drawn(1.0)))

    def listen(self, listener: Socket, host: str, port: int) -> tuple[str, int]:
        """Gives a port to a listener; returns the address."""
        if host not in OWN_ADDRESSES and not ipaddress.ip_address(host).is_loopback:
            raise OSError(errno.EADDRNOTAVAIL, os.strerror(errno.EADDRNOTAVAIL))
        if port in self._listeners:
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
        port = port or next(self._ports)
        self._listeners[port] = listener
        return host, port

    def free(self, address: tuple[str, int]) -> None:
        """Nobody listens there any more."""
        del self._listeners[address[1]]

    def add(self, opened: Socket) -> int:
        """Notes whose it is; returns its number."""
        self._of_group.setdefault(opened.group, []).append(opened)
        number = next(self._numbers)
        self._by_number[number] = opened
        return number

    def numbered(self, number: int) -> Socket:
        """The socket with this number."""
        return self._by_number[number]

    def forget(self) -> None:
        """Lets the simulation go, once it is over."""
        for each in list(self.files):
            each.let_go()

    def end(self, group: str) -> None:
        """Closes the sockets of a group, as the kernel does with those of a process."""
        for each in self._of_group.pop(group, []):
            each.really_close()

    def wait(self, ready_at: Callable[[], float], watched: Iterable[Socket], deadline: float) -> bool:
        """Waits until the time that `ready_at` tells, or the deadline [s]; returns whether it came. The time may change
        as one of the sockets does."""
        if ready_at() <= self.scheduler.now or self.scheduler.now >= deadline:
            return ready_at() <= self.scheduler.now
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
        watchers: events that are set at each change."""

    family, type, proto = socket.AF_INET, socket.SOCK_STREAM, 0

    def __init__(self, wires: Wires, group: str | None = None) -> None:
        self.group = wires.scheduler.current.group if group is None else group
        self.address = ("0.0.0.0", 0)
        self.watchers: list[clock.Event] = []
        self.incoming = wires.way()
        self.incoming.changed = self._way_changed
        self._wires, self._scheduler = wires, wires.scheduler
        self._peer: Socket | None = None
        self._timeout: float | None = None
        self._longest_send: float | None = None
        self._received, self._ended = b"", False
        self._reset = self._shut = self._said_end = self._closing = self._closed = self._resets = False
        self._listens, self._files = False, 0
        self._waiting: deque[Socket] = deque()
        self._number = wires.add(self)

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

    def writable_at(self) -> float:
        """When `send` need not wait [s]: now or not yet."""
        way = None if self._peer is None else self._peer.incoming
        full = way is not None and way.unread >= way.room and not (self._closed or self._reset or self._said_end)
        return math.inf if full else -math.inf

    # As socket.socket.

    def fileno(self) -> int:
        """Its number among the sockets; -1 when it is closed."""
        return -1 if self._closed else self._number

    def gettimeout(self) -> float | None:
        """How long it waits [s]."""
        return self._timeout

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
        if (level, option) == (socket.SOL_SOCKET, socket.SO_SNDTIMEO):
            seconds, microseconds = struct.unpack("ll", value)
            self._longest_send = seconds + 1e-6 * microseconds

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
        self._wait(self.readable_at, self._timeout)
        if not self._waiting:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        accepted = self._waiting.popleft()
        return accepted, accepted.getpeername()

    def recv(self, size: int) -> bytes:
        """What has come, at most `size` bytes; nothing at the end."""
        self._wait(self.readable_at, self._timeout)
        if self._reset:
            raise ConnectionResetError(errno.ECONNRESET, os.strerror(errno.ECONNRESET))
        for packet in self.incoming.take(self._scheduler.now):
            self._received += packet
            self._ended |= not packet
        data, self._received = self._received[:size], self._received[size:]
        self.incoming.unread -= len(data)
        if self._peer is not None and not math.isinf(self.incoming.room):
            self._peer._changed()
        return data

    def recv_into(self, buffer: Any) -> int:
        """As `recv`, into a buffer; returns how many bytes came."""
        data = self.recv(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def send(self, data: bytes) -> int:
        """Takes as much as there is room for."""
        if self._scheduler.current.killed:
            raise Killed  # what a killed program does at its ends reaches nobody
        if self.writable_at() > self._scheduler.now:
            self._wait(self.writable_at, self._timeout if self._longest_send is None else self._longest_send)
        if self._closed or self._peer is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        if self._reset or self._said_end:
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))
        if self._peer._closed:
            self._reset = True  # the answer of a kernel to what no program reads
        else:
            way = self._peer.incoming
            data = bytes(data) if len(data) <= way.room - way.unread else bytes(data[: int(way.room - way.unread)])
            way.put(self._scheduler.now, data)
            self._peer._changed()
        self._scheduler.maybe_give_way()
        return len(data)

    def sendall(self, data: bytes) -> None:
        """Sends all of it."""
        while data:
            data = data[self.send(data) :]

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

    def _wait(self, ready_at: Callable[[], float], timeout: float | None) -> None:
        deadline = math.inf if timeout is None else self._scheduler.now + timeout
        if not self._wires.wait(ready_at, [self], deadline):
            raise (
                TimeoutError("timed out") if self._timeout else BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
            )
        if self._closed:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    def _way_changed(self) -> None:
        for end in filter(None, (self, self._peer)):
            end._changed()

    def _changed(self) -> None:
        for each in list(self.watchers):  # who wakes up leaves
            each.set()


class Poll:
    """As select.poll."""

    def __init__(self, wires: Wires) -> None:
        self._wires = wires
        self._events: dict[Socket, int] = {}

    def register(self, watched: Socket, events: int) -> None:
        """Looks at a socket, too."""
        self._events[watched] = events

    def poll(self, milliseconds: float | None = None) -> list[tuple[Socket, int]]:
        """Those that are ready."""
        deadline = math.inf if milliseconds is None else self._wires.scheduler.now + milliseconds / 1000.0

        def ready_at(each: Socket) -> float:
            return each.writable_at() if self._events[each] & select.POLLOUT else each.readable_at()

        self._wires.wait(lambda: min(map(ready_at, self._events), default=math.inf), self._events, deadline)
        now = self._wires.scheduler.now
        return [(each, wanted) for each, wanted in self._events.items() if ready_at(each) <= now]


class Selector:
    """As selectors.DefaultSelector."""

    def __init__(self, wires: Wires) -> None:
        self._wires = wires
        self._keys: dict[Socket, selectors.SelectorKey] = {}

    def register(self, watched: Socket | int, events: int, data: Any = None) -> selectors.SelectorKey:
        """Looks at a socket, too, which may be given by its number."""
        found = self._socket(watched)
        if found.fileno() < 0:
            raise ValueError("it is closed")
        self._keys[found] = selectors.SelectorKey(found, found.fileno(), events, data)
        return self._keys[found]

    modify = register

    def unregister(self, watched: Socket | int) -> None:
        """Looks at it no longer."""
        del self._keys[self._socket(watched)]

    def get_key(self, watched: Socket | int) -> selectors.SelectorKey:
        """How it looks at a socket; raises KeyError if it does not."""
        return self._keys[self._socket(watched)]

    def get_map(self) -> dict[Socket, selectors.SelectorKey]:
        """What it looks at."""
        return self._keys

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Those that are ready, and for what."""
        deadline = math.inf if timeout is None else self._wires.scheduler.now + timeout

        def ready_at() -> float:
            return min((at for each, key in self._keys.items() for at, _ in _times(each, key)), default=math.inf)

        self._wires.wait(ready_at, self._keys, deadline)
        now, found = self._wires.scheduler.now, []
        for each, key in self._keys.items():
            ready = sum(event for at, event in _times(each, key) if at <= now)
            if ready:
                found.append((key, ready))
        return found

    def close(self) -> None:
        """Looks at nothing."""
        self._keys.clear()

    def _socket(self, watched: Socket | int) -> Socket:
        return self._wires.numbered(watched) if isinstance(watched, int) else watched


def _times(watched: Socket, key: selectors.SelectorKey) -> list[tuple[float, int]]:
    """When a socket is ready for each of the events that are waited for [s]."""
    times = ((watched.readable_at, selectors.EVENT_READ), (watched.writable_at, selectors.EVENT_WRITE))
    return [(time(), event) for time, event in times if key.events & event]


@contextlib.contextmanager
def virtual_wires(seed: int = 0) -> Iterator[Wires]:
    """A context of virtual time in which the modules of MODULES stand on wires."""
    with pytest.MonkeyPatch.context() as patch, virtual_time(seed) as scheduler:
        wires = Wires(scheduler)
        wires.stand_in(patch)
        yield wires


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
        self._socket: Socket | None = underlying
        self._own = own
        underlying._wires.files.add(self)

    def let_go(self) -> None:
        """Holds the simulation no longer: Python's collector does not see what a BufferedRWPair holds."""
        self._socket, self._own = None, False

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

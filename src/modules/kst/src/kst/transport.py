"""The socket to the toolbox server: whole lines out, whole replies in, every wait bounded. Small packets leave at
once (TCP_NODELAY). Keepalive and TCP_USER_TIMEOUT reveal a cable that is pulled out within seconds, even while the
link is idle or only written to."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections import deque

from kst.codec import MAX_LINE, KstLineSplitter, KstReply, ReplyKind, parse_reply
from kst.errors import ConnectionLost, NoServer

USER_TIMEOUT_S = 3.0  # a link whose peer has not confirmed sent bytes for this long is lost [s]
_KEEPALIVE = ((socket.TCP_KEEPIDLE, 2), (socket.TCP_KEEPINTVL, 1), (socket.TCP_KEEPCNT, 2))
TOOLBOX, LEAP_RIG = "MatlabToolboxServer", "LeapRigServer"
"""The programs on the robot's controller, as the smartPad names them."""


class KstTransport:
    """One TCP connection; used from one thread, except `abort`. Every use of a lost link raises ConnectionLost.
    `monotonic`: the time in which it waits [s]; another transport may bring its own. `heard`: the first bytes that
    came; `program`: on the robot's controller."""

    monotonic = staticmethod(time.monotonic)
    program = TOOLBOX

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * USER_TIMEOUT_S))
        for option, value in _KEEPALIVE:
            self._socket.setsockopt(socket.IPPROTO_TCP, option, value)
        self._readable = select.poll()
        self._writable = select.poll()
        self._readable.register(self._socket, select.POLLIN)
        self._writable.register(self._socket, select.POLLOUT)
        self._splitter = KstLineSplitter()
        self.heard = b""
        self._replies: deque[KstReply] = deque()
        self._aborted = threading.Event()
        self._lost: str | None = None
        self._closed = False
        self.ended_by_peer = False

    @classmethod
    def connect(cls, host: str, port: int, timeout: float, program: str = TOOLBOX) -> KstTransport:
        """Connects within `timeout` seconds; NoServer: nobody listens there, or the address is unreachable."""
        address = f"{host}:{port}"
        server, waits = "toolbox server", " (it waits 60 s for a client)"
        if program != TOOLBOX:
            server, waits = "robot application", ""
        try:
            connected = socket.create_connection((host, port), timeout)
        except (OSError, OverflowError) as error:
            raise NoServer(
                f"no {server} at {address} ({error}): start {program} on the smartPad{waits} and check cable and"
                " address",
                address=address,
            ) from error
        if connected.getsockname() == connected.getpeername():
            # The kernel may give a free port of this machine to the connecting socket itself.
            connected.close()
            what = f"no {server} at {address}: the socket connected to itself; start the server"
            raise NoServer(what, address=address)
        transport = cls(connected)
        transport.program = program
        return transport

    def send(self, line: str, timeout: float) -> None:
        """Writes the line and its line feed; a peer that takes it only in part within `timeout` seconds is lost."""
        self._check()
        data = line.encode("ascii") + b"\n"
        deadline = 0.0
        while data:
            try:
                data = data[self._socket.send(data) :]
            except BlockingIOError:
                deadline = deadline or self.monotonic() + timeout
                if not self._wait(self._writable, deadline):
                    self.give_up(f"the controller has taken no more bytes for {timeout:g} s")
            except OSError as error:
                self.ended_by_peer = isinstance(error, ConnectionError)
                self.give_up(f"the link to the controller broke while writing ({error})")

    def receive(self, deadline: float) -> KstReply | None:
        """Returns the next reply, or None if none comes until `deadline`, in seconds of `monotonic`."""
        while not self._replies:
            self._check()
            if not self._wait(self._readable, deadline):
                return None
            self._read()
            if not self._replies and self.monotonic() >= deadline:  # bytes may come for ever
                return None
        return self._replies.popleft()

    @property
    def is_foreign(self) -> bool:
        """Whether bytes came, and none of the first ones are a reply of the toolbox."""
        lines = KstLineSplitter().feed(self.heard)
        return bool(self.heard) and all(parse_reply(line).kind is ReplyKind.FOREIGN for line in lines)

    @property
    def holder(self) -> str | None:
        """Who holds the arm, where the first line says that another client does."""
        lines = KstLineSplitter().feed(self.heard)
        first = parse_reply(lines[0]) if lines else None
        return first.reason if first is not None and first.kind is ReplyKind.BUSY else None

    def waiting(self) -> list[KstReply]:
        """Returns the replies that have arrived already; does not wait."""
        self._check()
        if self._readable.poll(0):
            self._read()
        if not self._replies:
            return []
        replies = list(self._replies)
        self._replies.clear()
        return replies

    def pause(self, duration: float) -> None:
        """Waits `duration` seconds, or until the link is aborted."""
        self._aborted.wait(duration)
        self._check()

    def give_up(self, reason: str) -> None:
        """Declares the link lost and raises ConnectionLost with the reason; the socket stays open until `close`."""
        self._lost = self._lost or reason
        self._check()

    def reopen(self) -> None:
        """Allows the last words on a link that was given up, unless the peer ended it or it was aborted or closed."""
        if not (self.ended_by_peer or self._aborted.is_set() or self._closed):
            self._lost = None

    def end_writing(self) -> None:
        """Tells the peer that no more bytes will come; its own are still taken."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)

    def abort(self) -> None:
        """Drops the connection without a command to the server; any thread may call it, a waiting call wakes up."""
        self._aborted.set()
        self._shut_down()

    def close(self) -> None:
        """Ends the use of the socket; only from the thread that uses it. A peer that is merely silent would lose the
        last words by answering to a closed socket, which resets the link. So the socket stays open to it, until it
        is closed a second time or collected."""
        self._lost = self._lost or "the connection is closed"
        if self._closed or self.ended_by_peer or self._aborted.is_set():
            self._shut_down()
            self._socket.close()
        self._closed = True

    def _read(self) -> None:
        chunk = 4096
        try:
            data = self._socket.recv(chunk)
        except BlockingIOError:
            return
        except OSError as error:
            self.ended_by_peer = isinstance(error, ConnectionError)
            self.give_up(f"the link to the controller broke ({error})")
        if not data:
            self._check()
            self.ended_by_peer = True
            self.give_up("the controller closed the connection: its application has ended")
        if len(self.heard) < MAX_LINE:
            self.heard += data
        self._replies.extend(map(parse_reply, self._splitter.feed(data)))

    def _wait(self, events: select.poll, deadline: float) -> bool:
        return bool(events.poll(1000.0 * max(deadline - self.monotonic(), 0.0)))

    def _check(self) -> None:
        if self._aborted.is_set():
            self._lost = self._lost or "the connection was aborted on this side"
        if self._lost is not None:
            cure = f"look after the arm, restart {self.program} on the smartPad and connect again"
            raise ConnectionLost(f"{self._lost}; {cure}")

    def _shut_down(self) -> None:
        # Not close(): another thread may be waiting on this descriptor, and its number could be given to a new file.
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

"""The relay: a rig connects to it from inside its lab, browsers connect to a port of each page, and each connection of
a browser passes through a WebSocket of the rig. The relay knows nothing of what passes, and stores nothing."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hashlib
import ipaddress
import re
import secrets
import socket
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from leap_motion.service.access import ConnectionLimits, VisitLimits, is_loopback
from leap_motion.service.socket_service import BoundedListener, SocketService, listen
from leap_rig.relay import greeting
from leap_rig.relay.greeting import CHUNK, NONCE, VISITOR, RelayFault
from leap_rig.relay.transport import TAKE_S, Passage, end, within

GREET_S = 5.0  # a rig that has not proved its key by then is gone
NO_RIG_S = 5.0  # so long a browser waits for a rig
MAX_VISITORS, VISITORS_OF_ADDRESS = 48, 16  # connections of browsers to a page
MAX_VISITS, VISITS_OF_ADDRESS = 60, 20  # new ones in a second, to all pages
MAX_RIG_SOCKETS = 160
REFUSED, BUSY = 1008, 1013  # codes of closing
FORWARDED = re.compile(rb"^X-Forwarded-For:(.*)$", re.IGNORECASE | re.MULTILINE)


class WaitingRig:
    """A WebSocket of the rig that waits for a browser."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection, self.over = connection, asyncio.Event()


class Relay(SocketService):
    """Serves until `stop`. `pages`: their names with the ports for browsers, on `host` as the port for the rig is; port
    0: any free one, see `port` and `pages`. `forwarded`: a proxy in front names the browsers' addresses. `say` gets
    sentences for the terminal. Raises OSError or OverflowError."""

    max_message_bytes = CHUNK
    write_limit = CHUNK
    pings = True

    def __init__(
        self,
        key: bytes,
        pages: Mapping[str, int],
        say: Callable[[str], None],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        forwarded: bool = False,
    ) -> None:
        super().__init__()
        self._key, self._say, self._salt = key, say, secrets.token_bytes(NONCE)
        door = listen(host, port)
        self._open(door, None, ConnectionLimits(MAX_RIG_SOCKETS, MAX_RIG_SOCKETS, newest_first=True))
        doors = {name: listen(host, number) for name, number in pages.items()}
        self._forwarded, hidden = forwarded, is_loopback(host) and not forwarded  # by a proxy on this machine
        of_address = MAX_VISITORS if hidden else VISITORS_OF_ADDRESS
        self._visitors = {name: ConnectionLimits(MAX_VISITORS, of_address) for name in pages}
        self._visits = VisitLimits(MAX_VISITS, MAX_VISITS if hidden else VISITS_OF_ADDRESS)
        self._page_doors = doors
        self.port: int = door.getsockname()[1]
        self.pages: dict[str, int] = {name: each.getsockname()[1] for name, each in doors.items()}
        self._waiting: deque[WaitingRig] = deque()
        self._run, self._sockets_of_run = b"", 0

    @contextlib.asynccontextmanager
    async def _serving(self) -> AsyncIterator[None]:
        self._arrived = asyncio.Event()
        async with contextlib.AsyncExitStack() as stack:
            await stack.enter_async_context(super()._serving())
            for name, door in self._page_doors.items():
                visit = functools.partial(self._visit, name)
                server = await asyncio.start_server(visit, sock=_bounded(door), limit=CHUNK)
                stack.callback(server.close)
            yield

    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        if request.path != "/rig" or "Upgrade" not in request.headers or "Origin" in request.headers:
            return connection.respond(404, "Not found.\n")
        return None

    async def _converse(self, connection: ServerConnection) -> None:
        """Serves a WebSocket of a rig to its end."""
        with contextlib.suppress(ConnectionClosed, asyncio.TimeoutError):
            try:
                run = await within(GREET_S, self._greet(connection))
            except RelayFault as fault:
                self._say(f"{fault} It was refused.")
                await connection.close(REFUSED, "that is not this relay's key")
                return
            if not self._enter(run):
                await connection.close(BUSY, "another rig is connected to this relay")
                return
            try:
                await self._wait(connection)
            finally:
                self._leave()

    async def _greet(self, connection: ServerConnection) -> bytes:
        nonce = secrets.token_bytes(NONCE)
        await connection.send(greeting.challenge(nonce))
        run, proof = greeting.proof(self._key, await connection.recv(), nonce)
        self._keep(connection)  # before the rig knows that it may go on
        await connection.send(proof)
        return run

    def _enter(self, run: bytes) -> bool:
        """Counts a WebSocket of a rig; returns False, and does not, if those of another one are open."""
        if self._sockets_of_run and run != self._run:
            return False
        if not self._sockets_of_run:
            self._say("A rig is connected.")
        self._run, self._sockets_of_run = run, self._sockets_of_run + 1
        return True

    def _leave(self) -> None:
        self._sockets_of_run -= 1
        if not self._sockets_of_run:
            self._say("No rig is connected any more.")

    async def _wait(self, connection: ServerConnection) -> None:
        """Waits until a browser has used the WebSocket, or it has ended."""
        rig = WaitingRig(connection)
        self._waiting.append(rig)
        self._arrived.set()
        waits = [asyncio.ensure_future(wait) for wait in (rig.over.wait(), connection.wait_closed())]
        try:
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()
            if rig in self._waiting:
                self._waiting.remove(rig)

    async def _visit(self, page: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serves a connection of a browser to its end."""
        rig, place, begun = None, None, b""
        try:
            address = writer.get_extra_info("peername")[0]
            if self._forwarded:
                begun = await within(GREET_S, reader.readuntil(b"\r\n\r\n"))
                address = forwarded_for(begun) or address
            place = self._visitors[page].enter(address, writer.close)
            if place is None or not self._visits.admit(address, self._loop.time()):
                return
            visitor = hashlib.sha256(self._salt + address.encode()).digest()[:VISITOR]
            rig = await within(NO_RIG_S, self._next_rig())
            await rig.connection.send(greeting.opening(visitor, page))
            if begun:
                await within(TAKE_S, rig.connection.send(begun))
            await Passage(reader, writer, rig.connection).run()
        except (
            ConnectionClosed,
            asyncio.TimeoutError,
            asyncio.IncompleteReadError,
            asyncio.LimitOverrunError,
            OSError,
        ):
            pass
        finally:
            if rig is not None:
                rig.over.set()
            await end(writer)
            if place is not None:
                self._visitors[page].leave(place)

    async def _next_rig(self) -> WaitingRig:
        while True:
            while self._waiting:
                rig = self._waiting.popleft()
                if rig.connection.state is State.OPEN:
                    return rig
            self._arrived.clear()
            await self._arrived.wait()


def forwarded_for(request: bytes) -> str:
    """Returns the last address in X-Forwarded-For, which the proxy added, or an empty text. Earlier ones are the
    browser's own."""
    added = FORWARDED.findall(request.partition(b"\r\n\r\n")[0])
    try:
        return str(ipaddress.ip_address(added[-1].rpartition(b",")[2].strip().decode("ascii"))) if added else ""
    except ValueError:  # and UnicodeDecodeError
        return ""


def _bounded(door: socket.socket) -> socket.socket:
    return BoundedListener(door, ConnectionLimits(MAX_VISITORS, MAX_VISITORS))  # type: ignore[return-value]

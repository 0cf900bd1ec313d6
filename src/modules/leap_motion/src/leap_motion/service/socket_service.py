"""A WebSocket server in an event loop of its own, whose connections are few, and end if they are not used. asyncio
accepts again by itself a second after the system had no descriptor or memory for a connection."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import socket
import ssl
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.protocol import State

from leap_motion.service.access import ConnectionLimits, Place, is_host_of, is_loopback, is_own_host
from leap_motion.service.certificate import Certificate

LONGEST_SLEEP_S = 0.2
OPEN_TIMEOUT_S = 5.0  # for the handshake of TLS, and then for that of the WebSocket
CLOSE_TIMEOUT_S = 0.5
GONE_S = 10.0  # what could not be sent within this time after the end of a conversation is dropped,
SEND_S = 2.0  # and within this one after the end of the service; a client that takes a message no sooner is gone
PING_S = 10.0  # another machine that answers no ping is gone
MAX_OF_ADDRESS = 12
GRACE_S = 1.0  # in which a new connection to a page gives way to none, to send the code
PAGE_CONNECTIONS, PAGE_CONNECTIONS_OF_ADDRESS = 64, 24  # to a page: four pages of a machine take 20 WebSockets


def listen(host: str, port: int) -> socket.socket:
    """Returns a listening socket; raises OSError or OverflowError if there cannot be one."""
    return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)


def own_names() -> tuple[str, ...]:
    """Returns the names by which this computer is known in its network."""
    name = socket.gethostname()
    return name, f"{name}.local"


class EndingConnection(ServerConnection):
    """Ends though its client is gone: before Python 3.11 the end of TLS waits for the client's without a limit."""

    def send_data(self) -> None:
        """Sends what waits; after the connection's own end, its socket is cut a little later."""
        super().send_data()
        if self.state is State.CLOSING:
            self.loop.call_later(2 * CLOSE_TIMEOUT_S, cut, self.transport.get_extra_info("socket"))


class SocketService(ABC):
    """Serves WebSockets on listening sockets, with TLS or without, until `stop`; a subclass answers requests in
    `_meet` and converses in `_converse`."""

    max_message_bytes = 4096
    write_limit = 2**15  # bytes that may wait in the program before `send` waits
    pings = False  # whether clients without TLS are pinged, too

    def __init__(self) -> None:
        self._doors: list[tuple[BoundedListener, ssl.SSLContext | None]] = []
        self._sockets: set[Any] = set()  # of the conversations
        self._stopping = False
        self._loop = asyncio.new_event_loop()

    def run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
            self._loop.run_until_complete(_end_tasks())
        finally:
            self._loop.close()

    def stop(self) -> None:
        """Makes `run` return soon; from a signal handler or any thread."""
        self._stopping = True

    def _open(
        self, listener: socket.socket, tls: ssl.SSLContext | None = None, limits: ConnectionLimits | None = None
    ) -> None:
        max_connections = 48
        limits = limits or ConnectionLimits(max_connections, MAX_OF_ADDRESS)
        self._doors.append((BoundedListener(listener, limits), tls))

    def _keep(self, connection: ServerConnection) -> None:
        """Lets a connection give way to no other."""
        for door, _ in self._doors:
            door.keep(connection.remote_address)

    def _soon(self, action: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the service has ended
            self._loop.call_soon_threadsafe(action, *arguments)

    async def _serve(self) -> None:
        async with self._serving():
            while not self._stopping:
                await asyncio.sleep(LONGEST_SLEEP_S)

    @contextlib.asynccontextmanager
    async def _serving(self) -> AsyncIterator[None]:
        logger = logging.getLogger(__name__)
        logger.setLevel(logging.CRITICAL)
        async with contextlib.AsyncExitStack() as stack:
            for listener, tls in self._doors:
                server = serve(
                    self._use,
                    sock=listener,
                    ssl=tls,
                    process_request=self._hear_request,
                    select_subprotocol=self._subprotocol,
                    compression=None,
                    open_timeout=OPEN_TIMEOUT_S,
                    close_timeout=CLOSE_TIMEOUT_S,
                    create_connection=EndingConnection,
                    max_size=self.max_message_bytes,
                    write_limit=self.write_limit,
                    ping_interval=PING_S if tls or self.pings else None,
                    ping_timeout=PING_S,
                    logger=logger,
                )
                await stack.enter_async_context(server)
            try:
                yield
            finally:
                for its_socket in self._sockets:
                    self._loop.call_later(SEND_S, cut, its_socket)

    async def _hear_request(self, connection: ServerConnection, request: Request) -> Response | None:
        response = await self._meet(connection, request)
        if response is not None:
            self._loop.call_later(GONE_S, cut, connection.transport.get_extra_info("socket"))
        return response

    async def _use(self, connection: ServerConnection) -> None:
        its_socket = connection.transport.get_extra_info("socket")
        self._sockets.add(its_socket)
        try:
            await self._converse(connection)
        finally:
            self._sockets.remove(its_socket)
            self._loop.call_later(GONE_S, cut, its_socket)

    def _subprotocol(self, connection: ServerConnection, offered: Sequence[Any]) -> Any:
        """Returns which of the subprotocols that a client offers is spoken; None: no such."""
        return None

    @abstractmethod
    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        """Returns the answer to a request; None for the WebSocket that it asks for."""

    @abstractmethod
    async def _converse(self, connection: ServerConnection) -> None:
        """Serves a WebSocket to its end."""


class PageService(SocketService):
    """Serves pages at `address`, and WebSockets to its own pages alone; with a certificate by https. `name`: a further
    name of this computer; `public`: the origin under which a relay or proxy shows the pages, such as
    https://rig.example.org. Raises CertificateError, OSError or OverflowError if it cannot."""

    def __init__(
        self, host: str, port: int, name: str = "", certificate: Certificate | None = None, public: str = ""
    ) -> None:
        super().__init__()
        self._public = public
        self.fingerprint = certificate.fingerprint() if certificate else ""
        tls = certificate.server() if certificate else None
        listener = listen(host, port)
        self._open(listener, tls, ConnectionLimits(PAGE_CONNECTIONS, PAGE_CONNECTIONS_OF_ADDRESS, True, GRACE_S))
        self._names = () if is_loopback(host) else (*own_names(), name)
        self._scheme = "https" if tls else "http"
        self.address = f"{self._scheme}://{_reachable(host)}:{listener.getsockname()[1]}/"

    def _answer(
        self, connection: ServerConnection, request: Request, pages: dict[str, Callable[[], Response]],
        sockets: Collection[str], apart: Collection[str] = (),
    ) -> Response | None:  # fmt: skip
        """Returns the answer to a request, by the paths of the pages and of the WebSockets; None for one of these.
        `apart`: the WebSockets that a sandboxed frame may open, too, whose origin is null."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) > 1 or len(origins) > 1:
            return connection.respond(400, "Give one Host and one Origin.\n")
        host, path = "".join(hosts), request.path.partition("?")[0]
        origin = self._public if is_host_of(host, self._public) else f"{self._scheme}://{host}"
        if origin != self._public and not is_own_host(host, connection.local_address[0], self._names):
            return connection.respond(403, "Ask for this page by the address that the rig shows.\n")
        if path in pages and "Upgrade" not in request.headers:
            return pages[path]()
        if path not in sockets:
            return connection.respond(404, "Not found.\n")
        allowed = (origin, "null") if path in apart else (origin,)
        if origins and origins[0] not in allowed:
            return connection.respond(403, "This is for its own page only.\n")
        return None


def page_response(body: bytes, *more: tuple[str, str], kind: str = "text/html") -> Response:
    """Returns the answer with a page, or another `kind` of text; `more`: further headers."""
    headers = Headers([("Content-Type", f"{kind}; charset=utf-8"), ("Content-Length", str(len(body))), *more])
    headers["Connection"] = "close"
    headers["Cache-Control"] = "no-store"
    return Response(200, "OK", headers, body)


def _reachable(host: str) -> str:
    """Returns the address at which other machines find this one, for a host that stands for all addresses."""
    if host == "0.0.0.0":
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))  # sends nothing, but chooses the interface
            return probe.getsockname()[0]
    return host


def cut(its_socket: Any) -> None:
    """Ends a connection, whatever its transport still waits for."""
    with contextlib.suppress(OSError):  # it has ended
        its_socket.shutdown(socket.SHUT_RDWR)


def cutter(connection: ServerConnection) -> Callable[[], None]:
    """Returns what ends a connection."""
    return functools.partial(cut, connection.transport.get_extra_info("socket"))


async def _end_tasks() -> None:
    """Ends what still runs, such as a connection that is being opened."""
    left = asyncio.all_tasks() - {asyncio.current_task()}
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)


class BoundedListener:
    """A listening socket that closes at once what is one connection too many, or what gives way to it."""

    def __init__(self, listener: socket.socket, limits: ConnectionLimits) -> None:
        self._listener = listener
        self._limits = limits
        self._places: dict[Any, Place] = {}  # by the address and port of who connected

    def accept(self) -> tuple[CountedSocket, Any]:
        """As of a socket that does not block."""
        max_refused = 100  # connections that are closed before others have their turn
        now = asyncio.get_running_loop().time()
        for _ in range(max_refused):
            accepted, address = self._listener.accept()
            place = self._limits.enter(address[0], functools.partial(cut, accepted), now=now)
            if place is not None:
                # asyncio leaves it out for a listener of create_server
                accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
                self._places[address] = place
                return CountedSocket(accepted, functools.partial(self._leave, address, place)), address
            accepted.close()
        raise ConnectionAbortedError("too many connections")  # which asyncio takes for a client that went away

    def keep(self, address: Any) -> None:
        """Lets the connection from an address and port give way to no other."""
        if address in self._places:
            self._places[address].kept = True

    def _leave(self, address: Any, place: Place) -> None:
        self._limits.leave(place)
        if self._places.get(address) is place:  # a new connection may have the port already
            del self._places[address]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._listener, name)


class CountedSocket:
    """A socket that tells of its end."""

    def __init__(self, accepted: socket.socket, ended: Callable[[], None]) -> None:
        self._accepted = accepted
        self._ended = ended
        self._open = True

    def close(self) -> None:
        self._accepted.close()
        if self._open:
            self._open = False
            self._ended()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._accepted, name)

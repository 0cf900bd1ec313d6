"""The WebSocket of a Leap service: each client is served as it requests, and a slow one does not delay the others."""

from __future__ import annotations

import asyncio
import contextlib
import http
import math
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from leap_motion.service import wire
from leap_motion.service.access import AccessCode, hostname, is_loopback, is_own_host
from leap_motion.service.certificate import Certificate, CertificateError
from leap_motion.service.socket_service import SEND_S, SocketService, cut, listen, own_names

LOOPBACK = "127.0.0.1"


class LeapServiceError(Exception):
    """The service cannot start; the text is one sentence for the user."""


class LeapClientLink:
    """One connection: its requests, and its newest pending frames."""

    def __init__(self, connection: ServerConnection, version: int, service: str) -> None:
        gated_from_version = 4
        self.connection = connection
        self.version = version
        self.wants = {"background": service == "gemini" or version < gated_from_version, "focused": False}
        self.events: list[str] = []
        self.frames: tuple[str, ...] = ()
        self.wake = asyncio.Event()

    def offer(self, frames: tuple[str, ...]) -> int:
        """Replaces the pending frames; returns how many frames that lost."""
        if not frames or not any(self.wants.values()):
            return 0
        lost, self.frames = len(self.frames), frames
        self.wake.set()
        return lost

    def notify(self, event: dict | None) -> None:
        """Sends a device event before the next frame."""
        if event is not None:
            self.events.append(wire.text(event))
            self.wake.set()

    async def send(self, message: str) -> None:
        """Sends a message; a client that does not take it within SEND_S is cut off. Raises ConnectionClosed."""
        its_socket = self.connection.transport.get_extra_info("socket")
        end = asyncio.get_running_loop().call_later(SEND_S, cut, its_socket)  # wait_for would take turns of the loop
        try:
            await self.connection.send(message)
        finally:
            end.cancel()


class LeapService(SocketService):
    """Sends the offered frames to all clients; port 0 takes any free one, see the attributes.

    A `host` that is no loopback address opens `secure_port` to other machines, by TLS with a `certificate`; they are
    served at /v6.json?code=CODE only. Only a web page of this machine is served: any other would see the hands, and
    take every second frame of a "gemini". Raises LeapServiceError if a port is taken, or such a host has no code or
    certificate."""

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = 6437,
        service: str = "2.3",  # one of wire.SERVICES, whose protocol it speaks
        version: str = "2.3.1",  # the header's serviceVersion
        serial: str = "LP00000000001",  # of the device
        code: str = "",
        certificate: Certificate | None = None,
        secure_port: int = 6436,
        simulated: bool = False,  # its hands are simulated or recorded
    ) -> None:
        shortest_code = 8
        self._service = service
        self._version = version
        self._serial = serial
        self._simulated = simulated
        self._clients: list[LeapClientLink] = []
        self._attached = True
        self._next = 0  # whose turn the frame is, where clients share them
        self.sent = self.lost = 0  # frames, of all clients
        self.mode = "desktop"  # tracking mode that clients asked for
        super().__init__()
        opened = not is_loopback(host)
        if opened and (len(code) < shortest_code or certificate is None):
            needs = f"a certificate and a code of at least {shortest_code} characters"
            raise LeapServiceError(
                f"Other machines reach the address {host!r}; use 127.0.0.1, or give {needs} as well."
            )
        self._code = AccessCode(code)
        self.host, self.port = self._listen(LOOPBACK if opened else host, port)
        if opened and certificate is not None:
            _, self.secure_port = self._listen(host, secure_port, certificate)

    @property
    def clients(self) -> int:
        return len(self._clients)

    def offer(self, *frames: str) -> None:
        """Sends a frame, or several at once, oldest first; from any thread. A client that has not yet taken the
        frames offered before gets the new ones instead. While the device is unplugged nothing is sent."""
        self._soon(self._hand_out, frames)

    def plug(self, attached: bool) -> None:
        """Tells the clients that the device was plugged in or out; from any thread."""
        self._soon(self._set_attached, attached)

    def _hand_out(self, frames: tuple[str, ...]) -> None:
        if not self._attached:
            return
        clients = list(self._clients)
        if self._service == "gemini" and clients:  # each frame goes to one client only
            self._next += 1
            clients = [clients[self._next % len(clients)]]
        for client in clients:
            self.lost += client.offer(frames)

    def _set_attached(self, attached: bool) -> None:
        self._attached = attached
        for client in self._clients:
            client.frames = client.frames if attached else ()
            client.notify(wire.device_event(client.version, self._service, self._serial, attached))

    def _listen(self, host: str, port: int, certificate: Certificate | None = None) -> tuple[str, int]:
        try:
            tls = certificate and certificate.server()
            listener = listen(host, port)
        except CertificateError as error:
            raise LeapServiceError(str(error)) from error
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            cure = "Stop the other Leap service, or choose another port."
            raise LeapServiceError(f"Cannot listen on {host}:{port} for the Leap service: {reason}. {cure}") from error
        self._open(listener, tls)
        return listener.getsockname()[:2]

    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuses the pages of other sites, and who comes by the secure port without the code."""
        arrived_at = connection.local_address[0]
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if not all(is_own_host(host, arrived_at, own_names()) for host in hosts) or not all(
            is_loopback(hostname(origin)) for origin in origins
        ):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "Pages of other sites get no hands.\n")
        if connection.transport.get_extra_info("sslcontext") is None:
            return None
        whose, now = connection.remote_address[0], self._loop.time()
        wait = self._code.wait(whose, now)
        if wait > 0.0:
            response = connection.respond(http.HTTPStatus.TOO_MANY_REQUESTS, "A wrong code came from your address.\n")
            response.headers["Retry-After"] = str(math.ceil(wait))
            return response
        given = parse_qs(urlsplit(request.path).query).get("code", [""])[0]
        if self._code.accepts(given, whose, now):
            return None
        return connection.respond(http.HTTPStatus.UNAUTHORIZED, "Add ?code= and the code of this service.\n")

    async def _while_held(self) -> None:
        """Waits while nothing may be sent."""

    async def _converse(self, connection: ServerConnection) -> None:
        assert connection.request is not None  # the handshake is over
        version = wire.version_of(connection.request.path.partition("?")[0], self._service)
        if version is None:
            await connection.close(1001)
            return
        client = LeapClientLink(connection, version, self._service)
        sender = asyncio.ensure_future(self._send(client))
        self._clients.append(client)
        try:
            async for message in connection:
                self._hear(client, message)
        except ConnectionClosed:
            pass
        finally:
            self._clients.remove(client)
            sender.cancel()

    def _hear(self, client: LeapClientLink, message: str | bytes) -> None:
        for policy, wanted in wire.policies(message, self._service).items():
            if policy in client.wants:
                client.wants[policy] = wanted
            elif policy in wire.MODES:
                self.mode = wire.MODES[policy] if wanted else "desktop"

    async def _send(self, client: LeapClientLink) -> None:
        with contextlib.suppress(ConnectionClosed):
            await client.send(wire.text(wire.header(client.version, self._service, self._version, self._simulated)))
            client.notify(wire.device_event(client.version, self._service, self._serial, self._attached))
            while True:
                await client.wake.wait()
                client.wake.clear()
                await self._while_held()
                while client.events:
                    await client.send(client.events.pop(0))
                frames, client.frames = client.frames, ()
                for frame in frames:
                    await client.send(frame)
                    self.sent += 1

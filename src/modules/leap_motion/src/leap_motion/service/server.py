"""The WebSocket of a Leap service: each client is served as it requests, and a slow one does not delay the others."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http
import ipaddress
import logging
import socket
from collections.abc import Callable
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from leap_motion.service import wire

CLOSE_TIMEOUT_S = 0.5
LONGEST_SLEEP_S = 0.2
GATED_FROM_VERSION = 4
MAX_MESSAGE_BYTES = 4096  # of a client; policies are shorter than 32
MAX_WRONG_CODES = 10  # afterwards no other machine is served
SHORTEST_CODE = 6


class LeapServiceError(Exception):
    """The service cannot start; the text is one sentence for the user."""


class AccessCode:
    """A code that clients of other machines must give; after MAX_WRONG_CODES wrong ones the right one is refused."""

    def __init__(self, code: str) -> None:
        if len(code) < SHORTEST_CODE:
            raise LeapServiceError(f"The code for other machines is shorter than {SHORTEST_CODE} characters.")
        self._code, self._wrong = code.encode(), 0

    def accepts(self, given: str) -> bool:
        """Returns whether `given` is the code."""
        if self._wrong >= MAX_WRONG_CODES:
            return False
        right = hmac.compare_digest(given.encode("utf-8", "replace"), self._code)
        self._wrong += not right
        return right


class LeapClientLink:
    """One connection: its requests, and its newest pending frames."""

    def __init__(self, connection: ServerConnection, version: int, service: str) -> None:
        self.connection, self.version = connection, version
        self.wants = {"background": service == "gemini" or version < GATED_FROM_VERSION, "focused": False}
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


class LeapService:
    """Sends the offered frames to all clients; port 0 takes any free one, see the attributes.

    A `host` that is no loopback address makes other machines clients: they are served at /v6.json?code=CODE only. A
    web page is served if this machine served it: else any page that somebody opens here would see the hands, and take
    every second frame of a "gemini".
    Raises LeapServiceError if a port is taken or such a host has no code.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 6437,
        service: str = "2.3",  # one of wire.SERVICES, whose protocol it speaks
        version: str = "2.3.1",  # the header's serviceVersion
        serial: str = "LP00000000001",  # of the device
        code: str = "",
    ) -> None:
        self._code = AccessCode(code) if code else None
        self._service, self._version, self._serial = service, version, serial
        self._clients: list[LeapClientLink] = []
        self._attached, self._stopping = True, False
        self._next = 0  # whose turn the frame is, where clients share them
        self.sent = self.lost = 0  # frames, of all clients
        self.mode = "desktop"  # tracking mode that clients asked for
        self._socket = self._listen(host, port)
        self.host, self.port = self._socket.getsockname()[:2]
        self._loop = asyncio.new_event_loop()

    @property
    def clients(self) -> int:
        """How many clients are connected."""
        return len(self._clients)

    def offer(self, *frames: str) -> None:
        """Sends a frame, or several at once, oldest first; from any thread. A client that has not yet taken the frames
        offered before gets the new ones instead. While the device is unplugged nothing is sent.
        """
        self._soon(self._hand_out, frames)

    def plug(self, attached: bool) -> None:
        """Tells the clients that the device was plugged in or out; from any thread."""
        self._soon(self._set_attached, attached)

    def run(self) -> None:
        """Serves until `stop` is called."""
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    def stop(self) -> None:
        """Makes `run` return soon; from a signal handler or any thread."""
        self._stopping = True

    def _soon(self, action: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the service has ended
            self._loop.call_soon_threadsafe(action, *arguments)

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

    def _listen(self, host: str, port: int) -> socket.socket:
        if self._code is None and not is_loopback(host):
            raise LeapServiceError(f"Other machines reach the address {host!r}; use 127.0.0.1, or give a code as well.")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            return socket.create_server((host, port), family=family)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            cure = "Stop the other Leap service, or choose another port."
            raise LeapServiceError(f"Cannot listen on {host}:{port} for the Leap service: {reason}. {cure}") from error

    async def _serve(self) -> None:
        async with self._serving():
            while not self._stopping:
                await asyncio.sleep(LONGEST_SLEEP_S)

    def _serving(self) -> serve:
        logger = logging.getLogger(__name__)
        logger.setLevel(logging.CRITICAL)
        return serve(
            self._converse,
            sock=self._socket,
            process_request=self._meet,
            compression=None,
            close_timeout=CLOSE_TIMEOUT_S,
            max_size=MAX_MESSAGE_BYTES,
            ping_interval=None,
            logger=logger,
        )

    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        if not all(_is_of_this_machine(origin) for origin in request.headers.get_all("Origin")):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "Pages of other sites get no hands.\n")
        if is_loopback(connection.remote_address[0]):
            return None
        given = parse_qs(urlsplit(request.path).query).get("code", [""])[0]
        if self._code is not None and self._code.accepts(given):
            return None
        return connection.respond(http.HTTPStatus.FORBIDDEN, "Add ?code= and the code that this service shows.\n")

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
            await client.connection.send(wire.text(wire.header(client.version, self._service, self._version)))
            client.notify(wire.device_event(client.version, self._service, self._serial, self._attached))
            while True:
                await client.wake.wait()
                client.wake.clear()
                await self._while_held()
                while client.events:
                    await client.connection.send(client.events.pop(0))
                frames, client.frames = client.frames, ()
                for frame in frames:
                    await client.connection.send(frame)
                    self.sent += 1


def _is_of_this_machine(origin: str) -> bool:
    """Returns whether a web page, by the Origin that its browser states, was served by this machine."""
    try:
        return is_loopback(urlsplit(origin).hostname or "")
    except ValueError:
        return False


def is_loopback(host: str) -> bool:
    """Returns whether only this machine reaches an address, or an address is this machine's."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback

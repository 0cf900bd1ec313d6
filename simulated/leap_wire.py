"""Leap services in this process and in virtual time, which LeapClient reaches by their address.

    with LeapWire() as wire:
        service = wire.play(Playback(GuidedOperator(ScriptedOperator(Script()))))
        node = graph.run("leap_motion", "leap_driver.py", f"_port:={service.port}")

They stand on simulated.wires: `play` starts the simulated service itself, `serve` one that may break its protocol."""

from __future__ import annotations

import contextlib
from typing import Any, Callable

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from common import clock
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.operator.sources import Playback

HOST = "127.0.0.1"


class LeapWire(contextlib.AbstractContextManager):
    """The services of a test, which end with it."""

    def __init__(self) -> None:
        self._ends: list[Callable[[], None]] = []

    def serve(self, *conversations: Conversation, port: int = 0) -> LeapService:
        """Starts a service; each connection has one of the conversations, later ones the last one again."""
        service = LeapService(conversations, port)
        self._ends.append(service.close)
        return service

    def play(self, playback: Playback, port: int = 0) -> SimulatedLeapService:
        """Starts the simulated service."""
        service = SimulatedLeapService(playback, HOST, port, 0)
        clock.Thread(target=service.run, name="leap service", daemon=True).start()
        self._ends.append(service.stop)
        return service

    def __exit__(self, *_: object) -> None:
        for end in self._ends:
            end()


class LeapService:
    """A service of WebSockets.

    Attributes:
        heard: what clients have sent and a conversation has received.
        paths: those of the requests.
        ended: set at its end."""

    def __init__(self, conversations: tuple[Conversation, ...], port: int) -> None:
        self.heard: list[Any] = []
        self.paths: list[str] = []
        self.ended = clock.Event()
        self._conversations = list(conversations)
        self._connections: list[ServerConnection] = []
        self._server = serve(self._converse, HOST, port, compression=None, close_timeout=0.5)
        self.port = self._server.socket.getsockname()[1]
        clock.Thread(target=self._server.serve_forever, name="leap service", daemon=True).start()

    def listen(self, connection: ServerConnection, count: int = 3) -> None:
        """Receives the client's policy messages."""
        self.heard += [connection.recv() for _ in range(count)]

    def stay(self, _connection: ServerConnection) -> None:
        """Says nothing until the service ends."""
        self.ended.wait()

    def close(self) -> None:
        """Ends the service and its connections."""
        self._server.shutdown()
        for connection in self._connections:
            connection.close(1001)
        self.ended.set()

    def _converse(self, connection: ServerConnection) -> None:
        self._connections.append(connection)
        talk = self._conversations.pop(0) if len(self._conversations) > 1 else self._conversations[0]
        self.paths.append(connection.request.path)  # type: ignore[union-attr]
        with contextlib.suppress(ConnectionClosed):
            talk(self, connection)


Conversation = Callable[[LeapService, ServerConnection], Any]

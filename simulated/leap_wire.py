"""A Leap service in this process and in virtual time, which LeapClient reaches by its address.

    with LeapWire() as wire:
        service = wire.play(Playback(GuidedOperator(ScriptedOperator(Script()))))
        node = graph.run("leap_motion", "leap_driver.py", f"_port:={service.port}")

The client's own socket, leap_motion.transport.LeapSocket, runs on simulated.wires, which stand in for its modules.
"""

from __future__ import annotations

import contextlib
import math
import socket
from collections.abc import Callable
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from common import clock
from leap_motion import transport
from leap_motion.service import wire
from rig_simulation.control_port import ControlPort
from rig_simulation.faults.injection import Faults
from rig_simulation.faults.leap import LEAP_FAULTS, FrameStream
from rig_simulation.operator.sources import Playback

VERSION, SERIAL = "2.3.1+simulated", "LP00000000001"
READ_BYTES = 65536
POLL_S = 0.02


class LeapWire(contextlib.AbstractContextManager):
    """The services of a test, which end with it."""

    def __init__(self) -> None:
        self._services: list[LeapService] = []

    def serve(self, *conversations: Conversation, port: int = 0) -> LeapService:
        """Starts a service; each connection has one of the conversations, later ones the last one again."""
        service = LeapService(conversations, port)
        self._services.append(service)
        return service

    def play(self, playback: Playback, port: int = 0) -> LeapService:
        """Starts a service with the frames of a playback, for one client at a time."""
        return self.serve(lambda service, connection: _play(playback, connection), port=port)

    def __exit__(self, *_: object) -> None:
        for service in self._services:
            service.close()


class LeapService:
    """A service.

    Attributes:
        heard: what clients have sent and a conversation has received.
        paths: those of the requests.
        ended: set at its end.
    """

    def __init__(self, conversations: tuple[Conversation, ...], port: int) -> None:
        self.heard: list[str] = []
        self.paths: list[str] = []
        self.ended = clock.Event()
        self._conversations = list(conversations)
        self._connections: list[Connection] = []
        self._listener = transport.socket.socket()
        self._listener.bind(("127.0.0.1", port))
        self._listener.listen()
        self.port = self._listener.getsockname()[1]
        clock.Thread(target=self._accept, name="leap service", daemon=True).start()

    def listen(self, connection: Connection, count: int = 3) -> None:
        """Receives the client's policy messages."""
        self.heard += [connection.recv() for _ in range(count)]

    def stay(self, _connection: Connection) -> None:
        """Says nothing until the service ends."""
        self.ended.wait()

    def close(self) -> None:
        """Ends the service and its connections."""
        self._listener.close()
        for connection in self._connections:
            connection.close(1001)
        self.ended.set()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # it was closed
            while True:
                client, _ = self._listener.accept()
                clock.Thread(target=self._converse, args=(client,), name="leap conversation", daemon=True).start()

    def _converse(self, client: Any) -> None:
        connection = Connection(client)
        self._connections.append(connection)
        talk = self._conversations.pop(0) if len(self._conversations) > 1 else self._conversations[0]
        with contextlib.suppress(ConnectionClosed, EOFError):
            self.paths.append(connection.accept())
            talk(self, connection)
        connection.close(1000)


Conversation = Callable[[LeapService, "Connection"], Any]


class Connection:
    """The service's side of a WebSocket.

    Attributes:
        hangs: while it is set, nothing that the client sends is read: pings stay without answer.
    """

    def __init__(self, client: Any) -> None:
        self._socket, self._protocol = client, ServerProtocol()
        self._messages: clock.Queue[Any] = clock.Queue()
        self._sending = clock.Lock()
        self.hangs = False

    def accept(self) -> str:
        """Takes the client's request; returns its path."""
        while True:
            self._read()
            for request in self._protocol.events_received():
                assert isinstance(request, Request)
                self._protocol.send_response(self._protocol.accept(request))
                self._flush()
                clock.Thread(target=self._listen, name="reads a leap client", daemon=True).start()
                return request.path

    def send(self, message: str | bytes) -> None:
        """Sends a message; raises ConnectionClosed once one side has ended the connection."""
        self._require_open()
        if isinstance(message, str):
            self._protocol.send_text(message.encode())
        else:
            self._protocol.send_binary(message)
        self._flush()

    def send_raw(self, data: bytes) -> None:
        """Sends bytes that may be no WebSocket frame."""
        self._socket.sendall(data)

    def recv(self, timeout: float | None = None) -> Any:
        """Returns the client's next message; raises ConnectionClosed at the end, clock.Empty after `timeout` [s]."""
        message = self._messages.get(timeout=timeout)
        if message is None:
            self._require_open()
        return message

    def close(self, code: int) -> None:
        """Ends the connection with a code."""
        with contextlib.suppress(OSError):
            if self._protocol.state is State.OPEN:
                self._protocol.send_close(code)
            self._flush()

    def reset(self) -> None:
        """Ends the connection as a program that is killed with bytes unread."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"")
        self._socket.close()

    def drop(self) -> None:
        """Ends the connection without a word, as a service that crashes."""
        self._socket.shutdown(socket.SHUT_WR)

    def _listen(self) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                self._read()
                for event in self._protocol.events_received():
                    if isinstance(event, Frame) and event.opcode in (Opcode.TEXT, Opcode.BINARY):
                        self._messages.put(event.data.decode())
                self._flush()
        self._messages.put(None)

    def _read(self) -> None:
        data = self._socket.recv(READ_BYTES)
        while self.hangs:
            clock.sleep(0.01)
        if not data:
            self._protocol.receive_eof()
            self._flush()
            raise EOFError
        self._protocol.receive_data(data)

    def _flush(self) -> None:
        with self._sending:
            for data in self._protocol.data_to_send():
                if data:
                    self._socket.sendall(data)
                else:
                    self._socket.shutdown(socket.SHUT_WR)

    def _require_open(self) -> None:
        protocol = self._protocol
        if protocol.state is not State.OPEN:
            raise ConnectionClosed(protocol.close_rcvd, protocol.close_sent, protocol.close_rcvd_then_sent)


class LeapDevice:
    """As rig_simulation.devices.leap.server.SimulatedLeapService: plays frames to all clients, with faults.

    Attributes:
        port, control_port: of the service, and of its faults.
    """

    def __init__(self, playback: Playback) -> None:
        self.faults = Faults(LEAP_FAULTS)
        self._playback, self._stream = playback, FrameStream(self.faults)
        self._service: LeapService | None = LeapService((self._attend,), 0)
        self._clients: list[Connection] = []
        self._control = ControlPort({**self.faults.requests, "state": lambda: {"clients": len(self._clients)}})
        self.port, self.control_port = self._service.port, self._control.port

    def _attend(self, service: LeapService, connection: Connection) -> None:
        if self.faults.is_on("cut"):
            connection.reset()
            return
        connection.hangs = self.faults.is_on("half_open")
        connection.send(wire.text(wire.header(6, "2.3", VERSION)))
        connection.send(self._event(not self.faults.is_on("unplugged")))
        while not wire.policies(connection.recv(), "2.3").get("background"):
            pass
        self._clients.append(connection)
        try:
            while True:
                connection.recv()
        finally:
            self._clients.remove(connection)

    @staticmethod
    def _event(attached: bool) -> str:
        return wire.text(wire.device_event(6, "2.3", SERIAL, attached) or {})

    def run(self) -> None:
        """Plays for ever."""
        start = clock.monotonic()
        while True:
            if self._service is None:
                if self.faults.is_on("restarted"):
                    clock.sleep(POLL_S)
                    continue
                self._service = LeapService((self._attend,), self.port)
                self._playback.restart()
                start = clock.monotonic()
            self._follow_faults()
            played = self._playback.next()
            clock.sleep(max(0.0, start + played.time - clock.monotonic()))
            if not self.faults.is_on("unplugged") and not self.faults.is_on("half_open"):
                self._send(self._stream.pass_on(played.text, start + played.time))

    def _follow_faults(self) -> None:
        changes = self.faults.changes()
        if changes.get("restarted") is not None and self._service is not None:
            self._service.close()
            self._service = None
        if "unplugged" in changes:
            self._send([self._event(changes["unplugged"] is None)])
        for client in list(self._clients):
            if changes.get("cut") is not None:
                client.reset()
            if "half_open" in changes:
                client.hangs = changes["half_open"] is not None

    def _send(self, texts: list[str]) -> None:
        for client in list(self._clients):
            with contextlib.suppress(ConnectionClosed, OSError):  # it goes
                for text in texts:
                    client.send(text)


def _play(playback: Playback, connection: Connection) -> None:
    connection.send(wire.text(wire.header(6, "2.3", VERSION)))
    connection.send(wire.text(wire.device_event(6, "2.3", SERIAL, True) or {}))
    while not wire.policies(connection.recv(), "2.3").get("background"):
        pass
    start = -math.inf
    while True:
        played = playback.next()
        start = max(start, clock.monotonic() - played.time)
        clock.sleep(max(0.0, start + played.time - clock.monotonic()))
        connection.send(played.text)

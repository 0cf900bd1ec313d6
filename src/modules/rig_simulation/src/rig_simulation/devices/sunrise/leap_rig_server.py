"""The robot application on the network: one client holds the arm, a second connection of it may stop and hear, and
whoever else comes is told who holds it. Source: sunrise_application, Connection.java."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
from typing import Any

from common import clock
from rig_simulation.devices.sunrise import leap_rig_words as words
from rig_simulation.devices.sunrise.java_text import RobotLineSplitter
from rig_simulation.devices.sunrise.leap_rig import LeapRigApplication
from rig_simulation.devices.sunrise.server import RESET_ON_CLOSE, SunriseServer

MOST_CONNECTIONS = 12
FIRST_SESSION = 100_000


@dataclasses.dataclass
class Visitor:
    """A connection that is not the client's."""

    name: str
    splitter: RobotLineSplitter = dataclasses.field(default_factory=RobotLineSplitter)
    lines: list[str] = dataclasses.field(default_factory=list)  # that wait until the arm is free


class LeapRigServer(SunriseServer):
    """Serves one client after another, however the one before went."""

    _application: LeapRigApplication

    def close(self) -> None:
        """Closes everything; may be called twice."""
        for connection in self._visitors:
            connection.close()
        super().close()

    def _start_application(self) -> None:
        self._visitors: dict[socket.socket, Visitor] = {}
        self._channel: socket.socket | None = None
        self._sessions, self._served, self._holder = 0, False, ""
        super()._start_application()

    def _new_application(self) -> LeapRigApplication:
        self._sessions += 1
        session = FIRST_SESSION + self._sessions
        return LeapRigApplication(self._arm, self._io, session, self._encoders.read, *self._refusals)

    @property
    def _waits(self) -> bool:
        return super()._waits and self._client is None and not self._served

    def _meet(self, client: socket.socket, name: str) -> None:
        if len(self._visitors) + (self._client is not None) == MOST_CONNECTIONS:
            self._log(f"more than {MOST_CONNECTIONS} connections: {name} is turned away")
            self._selector.unregister(client)
            client.close()
        else:
            self._visitors[client] = Visitor(name)

    def _hear(self, connection: Any) -> None:
        if connection is self._client:
            self._receive()
        elif connection in self._visitors:  # it is closed, perhaps, by what came before in this round
            self._hear_visitor(connection, self._visitors[connection])

    def _hear_visitor(self, connection: socket.socket, visitor: Visitor) -> None:
        try:
            data = connection.recv(65536)
        except OSError:
            data = b""
        visitor.lines += visitor.splitter.feed(data)
        with self.lock:
            self._listen(connection, visitor)
        if not data:
            self._dismiss(connection)

    def _listen(self, connection: socket.socket, visitor: Visitor) -> None:
        """Answers the lines of a visitor, who becomes the client by the first word that only a client may say."""
        while visitor.lines and connection in self._visitors:
            line, now = visitor.lines[0], self._next_time(0.0)
            request = words.read(line)
            if connection is self._channel:
                self._say(connection, self._application.second(line, now))
            elif request.name == "lrStop":
                self._log(f"{visitor.name} stops what moves")
                self._say(connection, self._application.stop())
            elif request.name == "lrChannel":
                self._join(connection, request)
            elif request.word is not None:
                self._admit(connection, visitor, now)
                return
            del visitor.lines[0]

    def _join(self, connection: socket.socket, request: words.Request) -> None:
        if self._client is None or not self._application.joins(request):
            self._say(connection, words.no(request.name, "no such session"))
            return
        if self._channel is not None:
            self._dismiss(self._channel)
        self._channel = connection
        self._say(connection, words.ok(request.name, request.numbers))

    def _admit(self, connection: socket.socket, visitor: Visitor, now: float) -> None:
        """Makes a visitor the client, sends it away, or lets it wait until the one before has gone."""
        if self._client is None and self._served:
            return
        if self._client is None:
            del self._visitors[connection]
            self._served, self._holder = True, visitor.name
            self._serve_client(connection, visitor.name, visitor.splitter)
            self._take_lines(visitor.lines)
        elif self._application.gives_way(now):
            self._lose_client(f"it is silent, and {visitor.name} waits")
        else:
            self._say(connection, f"busy_{words.plain(self._holder)}_\n")
            self._log(f"{visitor.name} is told that {self._holder} holds the arm")
            self._dismiss(connection)

    def _say(self, connection: socket.socket, text: str) -> None:
        try:
            connection.sendall(text.encode("ascii"))
        except OSError:
            self._dismiss(connection)

    def _dismiss(self, connection: socket.socket) -> None:
        if self._visitors.pop(connection, None) is not None:
            self._selector.unregister(connection)
            connection.close()
        if connection is self._channel:
            self._channel = None

    def _send(self) -> None:
        super()._send()
        events, self._application.events = self._application.events, []
        for sentence in events:
            self._log(sentence)
            if self._channel is not None:
                self._say(self._channel, words.event(sentence))

    def _reset_waiting_clients(self) -> None:
        """Resets who waits while the connection is cut; the end of a client is no end for the others."""
        if self.faults.is_on("cut"):
            self._dismiss_all()
            super()._reset_waiting_clients()

    def _close_port(self) -> None:
        self._dismiss_all()
        super()._close_port()

    def _dismiss_all(self) -> None:
        for connection in [*self._visitors]:
            with contextlib.suppress(OSError):
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
            self._dismiss(connection)

    def _take_turns(self) -> None:
        if self._listener is None:
            return
        if not super()._waits:  # its port was closed
            self._start_application()
        if self._served and self._client is None and not self._application.busy and not self._arm.v.any():
            self._served = False
            if self._channel is not None:
                self._dismiss(self._channel)
            self._application, self._waiting_since = self._new_application(), clock.monotonic()
            if self._settings.end_exits:
                self._stop.set()
        if self._waits:
            self._give_up_waiting()
        for connection, visitor in [*self._visitors.items()]:
            self._listen(connection, visitor)

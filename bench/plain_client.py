"""The peer of the toolbox client: what a short public Python client does for a servo goal, and no more.

It sends the numbers as text, reads until a line feed, and splits. It checks neither goals nor answers, knows no
time-out and no lost answer.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator

PAUSE_S = 0.4  # such clients wait this long after the start and after the stop of servo mode [s]


class PlainClient:
    """Asks one line at a time; `connected` makes one in servo mode."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection

    @classmethod
    @contextlib.contextmanager
    def connected(cls, port: int) -> Iterator[PlainClient]:
        """Connects to a server on loopback, starts servo mode at the joints of the arm, and ends both afterwards."""
        with socket.create_connection(("127.0.0.1", port), 10.0) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client = cls(connection)
            time.sleep(PAUSE_S)
            client.ask("TFtrans_0_0_0_0_0_0_")
            time.sleep(PAUSE_S)
            client.goal("jp", client.numbers("getJointsPositions"))
            client.ask("startDirectServoJoints")
            time.sleep(PAUSE_S)
            yield client
            client.ask("stopDirectServoJoints")
            time.sleep(PAUSE_S)
            connection.send(b"end\n")
            connection.recv(1)

    def ask(self, line: str) -> str:
        """Returns the answer to a line."""
        self._socket.send((line + "\n").encode())
        answer = b""
        while not answer.endswith(b"\n"):
            answer += self._socket.recv(1024)
        return answer.decode().strip()

    def numbers(self, line: str) -> list[float]:
        """Returns the numbers that answer a line."""
        return [float(text) for text in self.ask(line).split("_") if text]

    def goal(self, word: str, q: list[float]) -> list[float] | None:
        """Sends a servo goal, seven joints [rad]; returns the numbers of its answer, None for `jp`."""
        line = word + "_" + "_".join(str(angle) for angle in q) + "_"
        if word == "jp":
            assert self.ask(line) == "done"
            return None
        return self.numbers(line)

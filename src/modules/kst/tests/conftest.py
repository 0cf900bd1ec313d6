"""A toolbox server of a few lines that answers as a test tells it to."""

from __future__ import annotations

import contextlib
import queue
import socket
import struct
import threading

import pytest

HOME = "-0.7854_0.5236_0.0_-1.39626_0.0_1.22173_0.0_\n"


class ScriptedServer:
    """Accepts one client on a free port and answers each line by its first word.

    Attributes:
        answers: bytes per word; a word that is not in it stays unanswered, as on the real server.
        lines: the lines that came, in order.
    """

    def __init__(self) -> None:
        self.answers = {
            "TFtrans": b"done\n",
            "jRelVel": b"done\n",
            "jp": b"done\n",
            "doPTPinJS": b"done\n",
            "startDirectServoJoints": b"done\n",
            "stopDirectServoJoints": b"done\n",
            "getJointsPositions": HOME.encode(),
            "getPin3": b"1\n\n",
            "Torques_ext_J": b"0.1_0.2_0.3_0.4_0.5_0.6_0.7_\n",
        }
        self.lines: list[str] = []
        self.connection: socket.socket | None = None
        self._once: dict[str, queue.SimpleQueue] = {}
        self._connected, self._ended = threading.Event(), threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(20.0)
        self.port = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def once(self, word: str, *answers: bytes) -> None:
        """The next such words get these answers instead, one each; `b""` is silence."""
        for answer in answers:
            self._once.setdefault(word, queue.SimpleQueue()).put(answer)

    def push(self, data: bytes) -> None:
        """Sends bytes unasked."""
        assert self._connected.wait(60.0)
        self.connection.sendall(data)

    def words(self) -> list[str]:
        """The first words of the lines that came."""
        return [line.split("_")[0] if line.endswith("_") else line for line in self.lines]

    def end(self, reset: bool = False) -> None:
        """Closes the client's connection, with a reset instead of an end of file where asked."""
        assert self._connected.wait(60.0)
        if reset:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        # Wakes the reading thread, which then closes; with no lingering that is a reset.
        self.connection.shutdown(socket.SHUT_RD if reset else socket.SHUT_RDWR)

    def wait_for_end(self) -> bool:
        """Returns whether the client's connection is over."""
        return self._ended.wait(60.0)

    def close(self) -> None:
        """Ends everything."""
        # Wakes a thread that still waits for a client.
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        if self.connection is not None:
            with contextlib.suppress(OSError):
                self.connection.shutdown(socket.SHUT_RDWR)
        self._thread.join(25.0)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            self.connection, _ = self._listener.accept()
            self.connection.settimeout(20.0)
            self._connected.set()
            with self.connection, self.connection.makefile("rb") as reader:
                for raw in reader:
                    line = raw.decode("ascii").rstrip("\n")
                    self.lines.append(line)
                    if line == "end":
                        break
                    answer = self._answer(line.split("_")[0] if line.endswith("_") else line)
                    if answer:
                        self.connection.sendall(answer)
        self._ended.set()

    def _answer(self, word: str) -> bytes:
        if word in self._once and not self._once[word].empty():
            return self._once[word].get()
        return self.answers.get(word, b"")


@pytest.fixture
def server():
    """A scripted server that behaves well until told otherwise."""
    scripted = ScriptedServer()
    yield scripted
    scripted.close()


@pytest.fixture
def connect(server):
    """Connects a client to the scripted server with short waits; changes of the waits as keywords."""
    from kst.client import KstClient
    from kst.session import KstTiming

    clients = []

    def connect(**waits):
        quick = {"connect_settle": 0.0, "tool_settle": 0.0, "servo_start": 0.01, "servo_stop": 0.02, "rest": 0.0}
        timing = KstTiming(**{"reply": 20.0, "servo_reply": 20.0, "quiet": 0.05, "main_pause": 0.005, **quick, **waits})
        clients.append(KstClient.connect("127.0.0.1", server.port, timing=timing, timeout=10.0))
        return clients[-1]

    yield connect
    for client in clients:
        client.close()

"""A toolbox server of a few lines that answers as a test tells it to, on a wire in virtual time."""

from __future__ import annotations

import contextlib
import socket
import struct
import sys
from pathlib import Path

import pytest

from common import clock
from simulated.wires import DELAY_S, Socket, Wires

sys.path.append(str(Path(__file__).parent))  # where simulated_wire is

HOME = "-0.7854_0.5236_0.0_-1.39626_0.0_1.22173_0.0_\n"


class ScriptedServer:
    """Accepts one client on a free port and answers each line by its first word.

    Attributes:
        answers: bytes per word; a word that is not in it stays unanswered, as on the real server.
        lines: the lines that came, in order.
    """

    def __init__(self, wires: Wires) -> None:
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
        self.connection: Socket | None = None
        self._once: dict[str, list[bytes]] = {}
        self._ended = clock.Event()
        self._listener = wires.serve(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._suspended = wires.scheduler.suspended
        with wires.scheduler.in_group("server"):
            clock.Thread(target=self._serve, name="server", daemon=True).start()

    def once(self, word: str, *answers: bytes) -> None:
        """The next such words get these answers instead, one each; `b""` is silence."""
        self._once.setdefault(word, []).extend(answers)

    def push(self, data: bytes) -> None:
        """Sends bytes unasked; returns as they arrive."""
        self.connection.sendall(data)
        clock.sleep(DELAY_S)

    def words(self) -> list[str]:
        """The first words of the lines that came."""
        return [line.split("_")[0] if line.endswith("_") else line for line in self.lines]

    def end(self, reset: bool = False) -> None:
        """Closes the client's connection, with a reset instead of an end of file where asked; returns as it arrives."""
        if reset:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.connection.really_close()
        clock.sleep(DELAY_S)

    def freeze(self, frozen: bool = True) -> None:
        """It stands still, and its kernel keeps the connection; or continues."""
        (self._suspended.add if frozen else self._suspended.discard)("server")

    def has_ended(self) -> bool:
        """Whether the client's connection is over, as soon as its last bytes are here."""
        return self._ended.wait(2.0 * DELAY_S)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            self.connection, _ = self._listener.accept()
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
        return self._once[word].pop(0) if self._once.get(word) else self.answers.get(word, b"")


class ScriptedApplication(ScriptedServer):
    """The same with the words of the robot application, and further connections.

    Attributes:
        channel: the lines on them."""

    STATE = "state_{mode}_" + "_".join(["0.5"] * 7 + ["1.5"] * 7 + ["2.5"] * 7 + ["3.5"] * 3 + ["4.5"] * 3) + "_2.0_"

    def __init__(self, wires: Wires) -> None:
        self.channel: list[str] = []
        self._second: list[Socket] = []
        super().__init__(wires)
        self.answers.update(
            lrHello=b"ok_lrHello_leapRig_1_123456_watchdog_stop_contact_tool_soft_float_guide_state_\n",
            lrWatchdog=b"ok_lrWatchdog_0.2_10.0_\n",
            lrBeat=b"ok_lrBeat_\n",
            lrPause=b"ok_lrPause_\n",
            lrResume=b"no_lrResume_the mode is IDLE_\n",
            lrTool=b"ok_lrTool_1.12_-22.0_0.0_72.7_\n",
        )
        self.be("SERVO")

    def be(self, mode: str, rest: str = "T1_HAND_NOSTOP") -> None:
        """Sets the mode that it says."""
        self.answers["lrState"] = self.answers["jpState"] = f"{self.STATE.format(mode=mode)}{rest}_\n".encode()

    def tell(self, event: str) -> None:
        """Says something on the channel; returns as it arrives."""
        self._second[0].sendall(f"event_{event}_\n".encode())
        clock.sleep(DELAY_S)

    def lose_channel(self) -> None:
        """Closes it."""
        self._second[0].really_close()
        clock.sleep(DELAY_S)

    def _serve(self) -> None:
        clock.Thread(target=self._further, name="further", daemon=True).start()
        super()._serve()

    def _further(self) -> None:
        while self.connection is None:
            clock.sleep(DELAY_S)
        with contextlib.suppress(OSError):
            while True:
                self._second.append(self._listener.accept()[0])
                clock.Thread(target=self._hear, args=(self._second[-1],), name="channel", daemon=True).start()

    def _hear(self, connection: Socket) -> None:
        with contextlib.suppress(OSError), connection.makefile("rb") as reader:
            for raw in reader:
                line = raw.decode("ascii").rstrip("\n")
                self.channel.append(line)
                connection.sendall(f"ok_{line.split('_')[0]}_\n".encode())


@pytest.fixture
def takes():
    """A context that must take so many seconds."""

    @contextlib.contextmanager
    def takes(seconds):
        begun = clock.monotonic()
        yield
        assert clock.monotonic() - begun == pytest.approx(seconds, abs=0.02)

    return takes


@pytest.fixture
def server(wires):
    """A scripted server that behaves well until told otherwise."""
    return ScriptedServer(wires)


@pytest.fixture
def application(wires):
    """A scripted robot application."""
    return ScriptedApplication(wires)


@pytest.fixture
def greet(application):
    """Connects a client to it; settings as keywords."""
    from kst import ApplicationSettings
    from kst.client import KstClient

    clients = []

    def greet(tool=None, **settings):
        known = ApplicationSettings(**settings)
        clients.append(KstClient.connect("127.0.0.1", application.port, tool, application=known))
        return clients[-1]

    yield greet
    for client in clients:
        client.close()


@pytest.fixture
def connect(server):
    """Connects a client to the scripted server, with the waits as shipped; changes of them as keywords."""
    from kst.client import KstClient
    from kst.session import KstTiming

    clients = []

    def connect(**waits):
        clients.append(KstClient.connect("127.0.0.1", server.port, timing=KstTiming(**waits)))
        return clients[-1]

    yield connect
    for client in clients:
        client.close()

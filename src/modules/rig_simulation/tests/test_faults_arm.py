"""Every fault of the simulated controller, seen on the wire by a plain client; and that it ends again."""

from __future__ import annotations

import socket
import sys
import threading
import time
from pathlib import Path

import pytest

from common.errors import DeviceError
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.devices.sunrise.server import ServerSettings, SunriseServer
from rig_simulation.files import read_urdf

pytestmark = pytest.mark.clock

SCRIPT = Path(__file__).parents[1] / "scripts" / "sunrise_controller.py"
ROBOT = Robot(read_urdf("LBR7R800", "MF_elektrisch"))
ZEROS = "0.0_0.0_0.0_0.0_0.0_0.0_0.0_\n"
TARGET = "jp_0.3_0.3_0.3_0.3_0.3_0.3_0.3_"
SOON_S = 60.0


class Connection:
    """A client on a real socket."""

    def __init__(self, server):
        self.socket = socket.create_connection((server.host, server.port), SOON_S)
        self.socket.settimeout(SOON_S)
        self.replies = self.socket.makefile("rb")

    def send(self, line):
        self.socket.sendall(f"{line}\n".encode())

    def ask(self, line="getJointsPositions"):
        self.send(line)
        return self.replies.readline().decode("latin-1")

    def silent(self, seconds=0.3):
        self.socket.settimeout(seconds)
        try:
            self.socket.recv(1, socket.MSG_PEEK)
        except socket.timeout:
            return True
        finally:
            self.socket.settimeout(SOON_S)
        return False


@pytest.fixture
def server():
    server = SunriseServer(SimulatedArm(ROBOT, ArmSettings()), ServerSettings(), "127.0.0.1", 0, 0)
    thread = threading.Thread(target=server.run)
    thread.start()
    server.control = ControlClient("127.0.0.1", server.control_port, SOON_S)
    yield server
    server.stop()
    thread.join(SOON_S)
    server.control.close()
    assert not thread.is_alive()


@pytest.fixture
def connect(server):
    connections = []

    def connect():
        connections.append(Connection(server))
        return connections[-1]

    yield connect
    for connection in connections:
        connection.replies.close()
        connection.socket.close()


@pytest.fixture
def fault(server):
    def fault(name, **fields):
        server.control.ask("fault", name=name, **fields)

    return fault


@pytest.fixture
def moving(server, connect, wait_until):
    """A client whose arm is on its way."""
    client = connect()
    for line in ("jRelVel_0.01_", TARGET, "doPTPinJS"):  # slowly: the test may have to wait long
        assert client.ask(line) == "done\n"
    wait_until(lambda: joint(server) > 0.01, SOON_S, "the arm to move")
    return client


def joint(server):
    return server.control.ask("state")["joints"][0]


def reconnected(connect):
    """Returns whether a new client is served."""
    try:
        return connect().ask() != ""
    except OSError:
        return False


def test_cut(server, connect, moving, fault, wait_until):
    fault("cut")
    with pytest.raises(ConnectionResetError):
        moving.replies.readline()
    with pytest.raises((ConnectionResetError, BrokenPipeError)):
        connect().ask()
        connect().ask()
    wait_until(lambda: not any(server.control.ask("state")["velocities"]), SOON_S, "the arm to brake")
    assert joint(server) < 0.3
    fault("cut", on=False)
    wait_until(lambda: reconnected(connect), SOON_S, "a new client to be served")


def test_half_open(server, moving, fault, wait_until):
    fault("half_open")
    before = joint(server)
    moving.send("getJointsPositions")
    assert moving.silent(0.5)
    wait_until(lambda: joint(server) > before, SOON_S, "the arm to go on")
    fault("half_open", on=False)
    assert moving.replies.readline().count(b"_") == 7, "what was sent meanwhile is answered at the end"


def test_silent(server, connect, fault, wait_until):
    client = connect()
    fault("silent")
    client.send("blueOn")
    assert client.silent()
    wait_until(lambda: server.control.ask("state")["outputs"].get("blue"), SOON_S, "the command to be followed")
    assert client.silent()
    fault("silent", on=False)
    assert client.ask() == ZEROS


def test_silent_for_a_share_of_the_answers(server, connect, fault, wait_until):
    client = connect()
    fault("silent", value=0.5)
    for _ in range(100):
        client.send("getPin3")
    client.send("blueOn")
    wait_until(lambda: server.control.ask("state")["outputs"], SOON_S, "the commands to be followed")
    fault("silent", on=False)
    client.send("getJointsPositions")
    answers = 0
    while client.replies.readline() != ZEROS.encode():
        answers += 1
    assert 40 < answers < 160


def test_slow(connect, fault):
    client = connect()
    assert client.ask() == ZEROS
    fault("slow", value=0.5)
    begin = time.monotonic()
    client.send("getJointsPositions")
    client.send("blueOn")
    assert client.replies.readline() == ZEROS.encode()
    assert client.replies.readline() == b"done\n"
    assert time.monotonic() - begin >= 0.5
    client.send("getJointsPositions")
    fault("slow", on=False)
    assert client.ask("blueOn") == ZEROS, "answers keep their order"
    assert client.replies.readline() == b"done\n"


def test_garbled(connect, fault):
    client = connect()
    fault("garbled")
    garbage = client.ask()
    assert garbage != ZEROS
    assert garbage.count("\n") == 1
    assert len(garbage) == len(ZEROS)
    fault("garbled", on=False)
    assert client.ask() == ZEROS


def test_torn(connect, fault, wait_until):
    client = connect()
    fault("torn", value=0.02)

    def in_pieces():
        client.send("getJointsPositions")
        pieces = [client.socket.recv(4096)]
        while not pieces[-1].endswith(b"\n"):
            pieces.append(client.socket.recv(4096))
        assert b"".join(pieces) == ZEROS.encode()
        return len(pieces) > 5  # who reads late gets several in one

    wait_until(in_pieces, SOON_S, "an answer in pieces")
    fault("torn", on=False)
    assert client.ask() == ZEROS


def test_bursts(connect, fault, wait_until):
    client = connect()
    fault("bursts", value=0.5)

    def several_in_one_piece():
        for _ in range(3):
            client.send("getJointsPositions")
            time.sleep(0.02)
        lines = []
        while sum(lines) < 3:
            lines.append(client.socket.recv(4096).count(b"\n"))
        return max(lines) > 1

    wait_until(several_in_one_piece, SOON_S, "several answers in one piece")
    fault("bursts", on=False)


def test_nagle(server, connect, fault, wait_until):
    client = connect()
    assert client.ask() == ZEROS and no_delay(server)
    fault("nagle")
    wait_until(lambda: not no_delay(server), SOON_S, "the option to be taken back")
    assert client.ask() == ZEROS
    fault("nagle", on=False)
    wait_until(lambda: no_delay(server), SOON_S, "the option to be set again")


def no_delay(server):
    return bool(server._client.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))


def test_window(server, connect, fault, wait_until):
    client = connect()
    fault("window", value=0.2)
    assert not client.silent(0.01) or client.ask() == ZEROS, "a client that is there may stay"
    time.sleep(0.4)
    assert client.ask() == ZEROS
    client.send("end")
    wait_until(lambda: not reconnects(server), SOON_S, "the port to close")
    fault("window", on=False)
    wait_until(lambda: reconnected(connect), SOON_S, "a new client to be served on the same port")


def reconnects(server):
    try:
        socket.create_connection((server.host, server.port), SOON_S).close()
    except OSError:
        return False
    time.sleep(0.4)
    return True


def test_restarted(server, connect, moving, fault, wait_until):
    fault("restarted")
    assert moving.replies.read() == b"", "closed in order"
    wait_until(lambda: not any(server.control.ask("state")["velocities"]), SOON_S, "the arm to brake")
    with pytest.raises(ConnectionRefusedError):
        connect()
    fault("restarted", on=False)
    wait_until(lambda: reconnected(connect), SOON_S, "a new client to be served on the same port")


def test_refused(server, connect, fault):
    client = connect()
    for line in ("TFtrans_0_0_100_0_0_0", "jRelVel_0.5_", TARGET):
        assert client.ask(line) == "done\n"
    fault("refused")
    assert client.ask("doPTPinJS") == "done\n"
    assert client.replies.readline() == b"nak\n"
    assert client.ask("Eef_pos").startswith("0.0_0.0_1301.0"), "the tool is off"
    fault("refused", on=False)
    assert client.ask("doPTPinJS") == "done\n"
    assert client.replies.readline() == b"done\n"
    assert joint(server) == 0.3


def test_frozen(server, moving, fault, wait_until):
    fault("frozen")
    answer, before = moving.ask(), joint(server)
    wait_until(lambda: joint(server) > before + 0.01, SOON_S, "the arm to go on")
    assert moving.ask() == answer
    fault("frozen", on=False)
    assert moving.ask() != answer


def test_shifted(connect, fault):
    client = connect()
    fault("shifted", value=-0.25)
    assert client.ask() == "-0.25_" * 7 + "\n"
    fault("shifted", on=False)
    assert client.ask() == ZEROS


def test_the_control_port_lists_faults_and_refuses_unknown_ones(server, fault):
    fault("slow", value=0.5, duration=60.0)
    listed = {entry["name"]: entry for entry in server.control.ask("faults")["faults"]}
    assert {name for name, entry in listed.items() if entry["on"]} == {"slow"}
    assert listed["slow"]["value"] == 0.5
    assert 0.0 < listed["slow"]["left"] <= 60.0
    with pytest.raises(DeviceError):
        fault("dance")


def test_faults_of_the_command_line_are_there_from_the_start(processes, wait_until):
    process = processes.start(
        sys.executable, str(SCRIPT), "--port", "0", "--control-port", "0", "--fault", "cut", "--fault", "slow:60:0.5"
    )
    line = wait_until(process.log_path.read_text, 30.0, "the ready line").splitlines()[0]
    with ControlClient("127.0.0.1", int(line.rsplit(":", 1)[1]), SOON_S) as control:
        assert {entry["name"] for entry in control.ask("faults")["faults"] if entry["on"]} == {"cut", "slow"}
    assert processes.end(process) == 0


def test_an_unknown_fault_on_the_command_line_is_one_sentence(processes):
    program = processes.start(sys.executable, str(SCRIPT), "--fault", "dance")
    assert program.wait(60) == 1
    sentence = program.log_path.read_text()
    assert "'dance'" in sentence and sentence.count("\n") == 1

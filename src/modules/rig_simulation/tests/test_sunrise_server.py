"""The simulated controller on real sockets: framing, one client at a time, its life cycle, the program."""

from __future__ import annotations

import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from common.errors import DeviceError
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.sunrise import motions
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.java_text import MAX_LINE_BYTES, JavaLineSplitter
from rig_simulation.devices.sunrise.paths import Unreachable
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.devices.sunrise.server import ServerSettings, SunriseServer
from rig_simulation.files import FLANGES, ROBOTS, read_urdf

LONG_S = 60.0
"""Longest wait: this process may get no processor for long."""
SCRIPT = Path(__file__).parents[1] / "scripts" / "sunrise_controller.py"
ROBOT_URDF = read_urdf("LBR7R800", "MF_elektrisch")
HOME_LINE = "jp_-0.78540_0.52360_0.00000_-1.39626_0.00000_1.22173_0.00000_"
NEAR_LINE = "jp_0.02_0.02_0.02_0.02_0.02_0.02_0.02_"


class Connection:
    """A client on a real socket."""

    def __init__(self, server):
        self.socket = socket.create_connection((server.host, server.port), LONG_S)
        self.replies = self.socket.makefile("rb")

    def send(self, text):
        self.socket.sendall(text.encode())

    def ask(self, line):
        self.send(f"{line}\n")
        return self.replies.readline().decode()

    def silent(self, seconds=0.2):
        return not select.select([self.socket], [], [], seconds)[0]

    def at_end(self):
        return self.replies.read() == b""

    def close(self):
        self.replies.close()
        self.socket.close()


@pytest.fixture
def serve():
    running = []

    def start(**settings):
        server = SunriseServer(
            SimulatedArm(Robot(ROBOT_URDF), ArmSettings()), ServerSettings(**settings), "127.0.0.1", 0, 0
        )
        server.thread = threading.Thread(target=server.run)
        server.thread.start()
        server.control = ControlClient("127.0.0.1", server.control_port, LONG_S)
        running.append(server)
        return server

    yield start
    for server in running:
        server.stop()
        server.thread.join(LONG_S)
        assert not server.thread.is_alive()


def state(server):
    return server.control.ask("state")


def test_lines_end_as_the_servers_reader_ends_them():
    lines = JavaLineSplitter()
    assert lines.feed(b"a\nb\r\nc\rd\xc2\x85e\xe2\x80\xa8f\xe2\x80\xa9\n\ng") == list("abcdef")
    assert lines.feed(b"h\r") == ["gh"]
    assert lines.feed(b"\ni\n") == ["i"]
    assert lines.feed(b"\xff\xfe\n") == ["\ufffd\ufffd"]


def test_a_line_has_a_longest_length():
    lines = JavaLineSplitter()
    lines.feed(b"x" * MAX_LINE_BYTES)
    with pytest.raises(ValueError):
        lines.feed(b"x")


@pytest.mark.clock
def test_torn_and_glued_lines(serve):
    client = Connection(serve())
    for byte in "getJointsPositions\r\n":
        client.send(byte)
        time.sleep(0.001)
    assert client.replies.readline() == b"0.0_0.0_0.0_0.0_0.0_0.0_0.0_\n"
    client.send("blueOn\ngetPin3\nnoSuchCommand\n\npin1on\nEef_force\n")
    assert [client.replies.readline() for _ in range(5)] == [b"done\n", b"1\n", b"\n", b"done\n", b"0.0_0.0_0.0_\n"]
    client.close()


def test_a_session_moves_the_arm_and_ends(serve, wait_until):
    server = serve()
    client = Connection(server)
    wait_until(lambda: state(server)["connected"], 10.0, "the server to take the client")
    assert client.ask("jRelVel_0.25_") == "done\n"
    assert client.ask(NEAR_LINE) == "done\n"
    assert client.ask("doPTPinJS") == "done\n"
    assert client.replies.readline() == b"done\n"
    assert state(server)["joints"] == [0.02] * 7
    assert client.ask("startDirectServoJoints") == "done\n"
    assert state(server)["mode"] == "servo"
    wait_until(lambda: client.ask(NEAR_LINE) == "done\n" and state(server)["goals"] > 3, 10.0, "the servo")
    client.send("end\n")
    assert client.at_end()
    wait_until(lambda: not state(server)["connected"], 5.0, "the end of the application")
    again = Connection(server)
    assert again.ask("Eef_force") == "0.0_0.0_0.0_\n"
    again.close()
    client.close()


@pytest.mark.clock
def test_a_second_client_waits_unserved_and_is_reset_at_the_end(serve):
    server = serve()
    first, second = Connection(server), Connection(server)
    first.ask("getJointsPositions")
    second.send("getJointsPositions\n")
    assert second.silent()
    first.send("end\n")
    assert first.at_end()
    with pytest.raises(ConnectionResetError):
        second.replies.read()
    first.close()
    second.close()


def test_a_lost_client_stops_the_arm_and_the_next_is_served(serve, wait_until):
    server = serve()
    client = Connection(server)
    for line in ("jRelVel_0.02_", HOME_LINE, "doPTPinJS"):  # slowly: it is to be seen on its way
        client.ask(line)
    wait_until(lambda: state(server)["velocities"][0] < -1e-3, 10.0, "the motion")
    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.close()
    wait_until(lambda: state(server)["mode"] == "idle", 10.0, "the stop")
    stopped = state(server)
    assert not any(stopped["velocities"])
    assert -0.78 < stopped["joints"][0] < 0.0
    client = Connection(server)
    assert client.ask("Eef_force") == "0.0_0.0_0.0_\n"
    client.close()


def test_a_lost_client_can_leave_the_port_deaf_and_the_servo_running(serve, wait_until):
    server = serve(deaf_after_lost_client=True)
    client = Connection(server)
    client.ask("startDirectServoJoints")
    wait_until(lambda: client.ask(NEAR_LINE) == "done\n" and state(server)["goals"] > 3, 10.0, "the servo")
    client.close()
    wait_until(lambda: not state(server)["connected"], 10.0, "the loss")
    wait_until(lambda: state(server)["joints"][0] > 0.018, 10.0, "the last goal")
    assert state(server)["mode"] == "servo"
    deaf = Connection(server)
    deaf.send("getJointsPositions\n")
    assert deaf.silent()
    deaf.close()


@pytest.mark.clock
def test_an_overlong_line_loses_that_client_only(serve):
    server = serve()
    client = Connection(server)
    with pytest.raises((BrokenPipeError, ConnectionResetError)):
        while True:
            client.send("x" * 65536)
    client.close()
    client = Connection(server)
    assert client.ask("getJointsPositions")
    client.close()


@pytest.mark.clock
def test_end_can_end_the_server(serve):
    server = serve(end_exits=True)
    client = Connection(server)
    client.send("end\n")
    assert client.at_end()
    server.thread.join(LONG_S)
    assert not server.thread.is_alive()
    with pytest.raises(ConnectionRefusedError):
        Connection(server)
    client.close()


@pytest.mark.clock
def test_without_a_client_it_can_end(serve):
    server = serve(wait_for_client=0.05)
    server.thread.join(LONG_S)
    assert not server.thread.is_alive()


def test_control_port_stops_and_releases(serve, wait_until):
    server = serve()
    with pytest.raises(DeviceError):
        server.control.ask("release")
    server.control.ask("set_external_torque", value=[0, 0, 0, -26, 0, 0, 0])
    assert "joint 4 is 26.0 Nm" in state(server)["safety_stop"]
    with pytest.raises(DeviceError, match="persists"):
        server.control.ask("release")
    server.control.ask("set_external_torque", value=[0] * 7)
    server.control.ask("release")
    assert (state(server)["safety_stop"], state(server)["stops"]) == (None, 1)
    server.control.ask("set_tcp_force", value=[0, 1.5, 0])
    client = Connection(server)
    assert client.ask("Eef_force") == "0.0_1.5_0.0_\n"
    client.close()


@pytest.mark.clock
@pytest.mark.parametrize("value", [[0] * 6, "abcdefg", [None] * 7, [True] * 7, 3])
def test_control_port_refuses_what_are_no_torques(serve, value):
    server = serve()
    with pytest.raises(DeviceError):
        server.control.ask("set_external_torque", value=value)


def test_every_arm_has_a_description():
    for robot in ROBOTS:
        for flange in FLANGES:
            assert Robot(read_urdf(robot, flange)).upper[0] > 2.9


def start_program(*arguments):
    source = os.pathsep.join(p for p in sys.path if p.endswith("src"))
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), "--port", "0", "--control-port", "0", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([source, os.environ.get("PYTHONPATH", "")])},
    )


@pytest.mark.clock
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_program_says_when_it_is_ready_and_ends_without_a_traceback(number):
    program = start_program("--robot", "LBR14R820", "__name:=arm")
    ready = program.stdout.readline()
    assert ready.startswith("sunrise_controller: listening on 127.0.0.1:")
    assert ", control port 127.0.0.1:" in ready
    with ControlClient("127.0.0.1", int(ready.rsplit(":", 1)[1]), LONG_S) as control:
        assert abs(control.ask("state")["flange"][2][3] - 1.341) < 1e-9
    program.send_signal(number)
    assert program.communicate(timeout=LONG_S) == ("", "")
    assert program.returncode == 0


@pytest.mark.clock
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--robot", "LBR9"], "choose from 'LBR7R800', 'LBR14R820'"),
        (["--flange", "none"], "'MF_IO_pneumatisch'"),
        (["--host", "0.0.0.0"], "loopback"),
        (["--port", "70000"], "70000"),
        (["--safety-speed", "nan"], "nan"),
        (["--trajectory-time", "0"], "'0'"),
        (["nonsense"], "unknown arguments: nonsense"),
    ],
)
def test_the_program_refuses_bad_arguments_in_one_sentence(arguments, sentence):
    program = start_program(*arguments)
    out, err = program.communicate(timeout=LONG_S)
    assert (program.returncode, out) == (1, "")
    assert sentence in err
    assert err.count("\n") == 1


@pytest.mark.clock
def test_the_program_says_that_its_port_is_taken():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        program = start_program("--port", str(taken.getsockname()[1]))
        out, err = program.communicate(timeout=LONG_S)
    assert (program.returncode, out, err.count("\n")) == (1, "", 1)
    assert "in use" in err


def slow_motion(monkeypatch, serve, step_s):
    """A server whose arm moves, its client, and the steps of the arm, each of which takes the time `step_s` [s]."""
    steps, step = [], SimulatedArm.step

    def slow_step(arm, dt):
        steps.append(dt)
        time.sleep(step_s)
        step(arm, dt)

    server = serve()
    client = Connection(server)
    # Slow: the word that says the motion has ended must not come between the questions.
    for line in ("jRelVel_0.02_", "jp_1.0_0.0_0.0_0.0_0.0_0.0_0.0_"):
        assert client.ask(line) == "done\n"
    monkeypatch.setattr(SimulatedArm, "step", slow_step)
    assert client.ask("doPTPinJS") == "done\n"
    return server, client, steps


def test_a_machine_that_cannot_keep_up_answers_and_its_arm_moves_in_slow_motion(monkeypatch, serve, wait_until):
    server, client, _ = slow_motion(monkeypatch, serve, 0.002)
    wait_until(lambda: state(server)["joints"][0] > 0.0, 10.0, "the arm to move")
    waits = []
    for _ in range(10):
        begin = time.monotonic()
        assert client.ask("getJointsPositions").count("_") == 7
        waits.append(time.monotonic() - begin)
    assert min(waits) < 0.15, "20 steps of 2 ms, not a second of them"
    assert state(server)["age"] < 1.0, "what it is behind does not grow"
    client.close()


def test_an_arm_that_lags_answers_before_it_makes_up_its_lag(monkeypatch, serve, wait_until):
    _, client, steps = slow_motion(monkeypatch, serve, 0.005)
    wait_until(lambda: len(steps) > 10, 10.0, "the arm to lag")
    taken = []
    for _ in range(10):
        before = len(steps)
        client.ask("getJointsPositions")
        taken.append(len(steps) - before)
    assert sorted(taken)[5] <= 3, "the rest of the present piece, none of the 200 steps that it lags"
    client.close()


@pytest.mark.clock
def test_a_line_that_takes_long_to_plan_does_not_hold_up_the_reader(monkeypatch, serve):
    go_on = threading.Event()

    def plan(*_, **__):
        go_on.wait(LONG_S)
        raise Unreachable("far away")

    monkeypatch.setattr(motions, "line", plan)
    client = Connection(serve())
    assert client.ask("doPTPinCS") == "done\n", "the first word comes before the planning"
    for _ in range(3):
        assert client.ask("getJointsPositions").count("_") == 7
    client.send("Eef_pos\n")
    go_on.set()
    assert client.replies.readline() == b"nak\n"
    client.close()

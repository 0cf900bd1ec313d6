"""The simulated controller on wires in virtual time: framing, one client at a time, its life cycle, the program."""

from __future__ import annotations

import re
import signal
import socket
import struct

import pytest
from toolbox_client import ToolboxClient

from common import clock
from common.errors import DeviceError
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.sunrise.arm import SimulatedArm
from rig_simulation.devices.sunrise.java_text import MAX_LINE_BYTES, JavaLineSplitter
from rig_simulation.devices.sunrise.program import main
from simulated.wires import DELAY_S

RESTING_S, LAG_S, PIECE_STEPS = 0.02, 0.2, 2
"""How often the server looks after an arm at rest, the longest lag, and what of it the arm makes up at once."""
HOME_LINE = "jp_-0.78540_0.52360_0.00000_-1.39626_0.00000_1.22173_0.00000_"
NEAR_LINE = "jp_0.02_0.02_0.02_0.02_0.02_0.02_0.02_"


@pytest.fixture
def connect(wires):
    """Connects a client to a server."""
    return lambda server: ToolboxClient(wires, server)


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


def test_torn_and_glued_lines(serve, connect):
    client = connect(serve())
    for byte in "getJointsPositions\r\n":
        client.send(byte)
        clock.sleep(0.001)
    assert client.hear() == "0.0_0.0_0.0_0.0_0.0_0.0_0.0_\n"
    client.send("blueOn\ngetPin3\nnoSuchCommand\n\npin1on\nEef_force\n")
    assert [client.hear() for _ in range(5)] == ["done\n", "1\n", "\n", "done\n", "0.0_0.0_0.0_\n"]


def test_an_answer_takes_no_longer_than_the_wire(serve, connect):
    client = connect(serve())
    for _ in range(50):
        begin = clock.monotonic()
        client.ask()
        assert clock.monotonic() - begin == pytest.approx(2.0 * DELAY_S)
        clock.sleep(0.0013)


def test_a_session_moves_the_arm_and_ends(serve, connect):
    server = serve()
    client = connect(server)
    assert client.ask("jRelVel_0.25_") == "done\n" and state(server)["connected"]
    assert client.ask(NEAR_LINE) == "done\n"
    assert client.ask("doPTPinJS") == "done\n"
    assert client.hear() == "done\n"
    assert state(server)["joints"] == [0.02] * 7
    assert client.ask("startDirectServoJoints") == "done\n"
    assert state(server)["mode"] == "servo"
    clock.sleep(0.3)  # until then goals are overwritten
    for goals in range(1, 5):
        assert client.ask(NEAR_LINE) == "done\n" and state(server)["goals"] == goals
    client.send("end\n")
    assert client.at_end()
    assert not state(server)["connected"]
    clock.sleep(RESTING_S)  # in which the application starts again
    assert connect(server).ask("Eef_force") == "0.0_0.0_0.0_\n"


def test_a_second_client_waits_unserved_and_is_reset_at_the_end(serve, connect):
    server = serve()
    first, second = connect(server), connect(server)
    first.ask()
    second.send("getJointsPositions\n")
    assert second.silent(10.0)
    first.send("end\n")
    assert first.at_end()
    with pytest.raises(ConnectionResetError):
        second.replies.read()


def test_a_lost_client_stops_the_arm_and_the_next_is_served(serve, connect):
    server = serve()
    client = connect(server)
    for line in ("jRelVel_0.25_", HOME_LINE, "doPTPinJS"):
        client.ask(line)
    clock.sleep(0.5)
    assert state(server)["velocities"][0] < -0.05
    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.close()
    clock.sleep(0.3)
    stopped = state(server)
    assert stopped["mode"] == "idle" and not any(stopped["velocities"])
    assert -0.78 < stopped["joints"][0] < 0.0
    assert connect(server).ask("Eef_force") == "0.0_0.0_0.0_\n"


def test_a_lost_client_can_leave_the_port_deaf_and_the_servo_running(serve, connect):
    server = serve(deaf_after_lost_client=True)
    client = connect(server)
    client.ask("startDirectServoJoints")
    clock.sleep(0.3)
    assert client.ask(NEAR_LINE) == "done\n"
    client.close()
    clock.sleep(1.0)
    now = state(server)
    assert not now["connected"] and now["joints"][0] > 0.018 and now["mode"] == "servo"
    deaf = connect(server)
    deaf.send("getJointsPositions\n")
    assert deaf.silent(10.0)


def test_an_overlong_line_loses_that_client_only(serve, connect):
    server = serve()
    client = connect(server)
    with pytest.raises((BrokenPipeError, ConnectionResetError)):
        for _ in range(MAX_LINE_BYTES // 1000 + 3):
            client.send("x" * 1000)
            clock.sleep(0.001)
    assert connect(server).ask()


def test_end_can_end_the_server(serve, connect):
    server = serve(end_exits=True)
    client = connect(server)
    client.send("end\n")
    assert client.at_end()
    server.thread.join(RESTING_S)
    assert not server.thread.is_alive()
    with pytest.raises(ConnectionRefusedError):
        connect(server)


def test_without_a_client_it_can_end(serve):
    begin = clock.monotonic()
    server = serve(wait_for_client=60.0)
    server.thread.join(100.0)
    assert 60.0 < clock.monotonic() - begin <= 60.0 + RESTING_S


def test_control_port_stops_and_releases(serve, connect):
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
    assert connect(server).ask("Eef_force") == "0.0_1.5_0.0_\n"


@pytest.mark.parametrize("value", [[0] * 6, "abcdefg", [None] * 7, [True] * 7, 3])
def test_control_port_refuses_what_are_no_torques(serve, value):
    with pytest.raises(DeviceError):
        serve().control.ask("set_external_torque", value=value)


@pytest.mark.ros
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_program_says_when_it_is_ready_and_ends_without_a_traceback(virtual_graph, number):
    arguments = ("--port", "0", "--control-port", "0", "--robot", "LBR14R820", "__name:=arm")
    program = virtual_graph.run("rig_simulation", "sunrise_controller.py", *arguments)
    clock.sleep(0.1)
    said = r"sunrise_controller: listening on 127\.0\.0\.1:\d+, control port 127\.0\.0\.1:(\d+)\n"
    ready = re.fullmatch(said, program.log)
    with ControlClient("127.0.0.1", int(ready[1])) as control:
        assert control.ask("state")["flange"][2][3] == pytest.approx(1.341)
    program.send_signal(number)
    assert program.wait(RESTING_S + 0.01) == 0 and program.log == ready[0]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--host", "0.0.0.0"], "loopback"),
        (["nonsense"], "unrecognized arguments: nonsense"),
        (["--port", "30001"], "in use"),
    ],
)
def test_the_program_refuses_bad_arguments_in_one_sentence(wires, capsys, arguments, sentence):
    wires.serve(("127.0.0.1", 30001))
    with pytest.raises(SystemExit) as end:
        raise SystemExit(main(["--port", "0", "--control-port", "0", *arguments]))
    out, err = capsys.readouterr()
    assert (end.value.code, out, err.count("\n")) == (1, "", 1)
    assert sentence in err


@pytest.fixture
def slow_motion(monkeypatch, serve, connect):
    """Makes a server whose arm moves, its client, and the steps of the arm, each of which takes `step_s` [s]."""

    def make(step_s):
        steps, step = [], SimulatedArm.step

        def slow_step(arm, dt):
            steps.append(dt)
            clock.sleep(step_s)
            step(arm, dt)

        server = serve()
        client = connect(server)
        # Slow: the word that says the motion has ended must not come between the questions.
        for line in ("jRelVel_0.02_", "jp_1.0_0.0_0.0_0.0_0.0_0.0_0.0_"):
            assert client.ask(line) == "done\n"
        monkeypatch.setattr(SimulatedArm, "step", slow_step)
        assert client.ask("doPTPinJS") == "done\n"
        clock.sleep(1.0)
        return server, client, steps

    return make


def test_a_machine_that_cannot_keep_up_answers_and_its_arm_moves_in_slow_motion(slow_motion):
    server, client, steps = slow_motion(0.002)
    before, begin = len(steps), clock.monotonic()
    for _ in range(100):
        asked, taken = clock.monotonic(), len(steps)
        assert client.ask().count("_") == 7
        assert len(steps) - taken <= PIECE_STEPS, "the rest of the present piece, none of the steps that it lags"
        assert clock.monotonic() - asked <= PIECE_STEPS * 0.002 + 2.0 * DELAY_S + 1e-9
    clock.sleep(1.0)
    seconds = clock.monotonic() - begin
    assert sum(steps[before:]) == pytest.approx(seconds / 2.0, abs=0.02)
    assert state(server)["age"] == pytest.approx(LAG_S, abs=0.02), "what it is behind does not grow"

"""Every fault of the simulated controller, seen on the wire by a plain client; and that it ends again."""

from __future__ import annotations

import math

import pytest
from toolbox_client import ToolboxClient

from common import clock
from rig_simulation.control_port import ControlClient
from simulated.wires import DELAY_S

TICK_S = 0.02  # so often the server of an arm at rest looks after its faults
ZEROS = "0.0_0.0_0.0_0.0_0.0_0.0_0.0_\n"
TARGET = "jp_0.3_0.3_0.3_0.3_0.3_0.3_0.3_"
BRAKES_S = 0.3
"""In this time the arm brakes, and the application starts again."""


@pytest.fixture
def server(serve):
    return serve()


@pytest.fixture
def connect(wires, server):
    return lambda: ToolboxClient(wires, server)


@pytest.fixture
def fault(server):
    """Switches a fault, and waits until the server has noticed."""

    def fault(name, **fields):
        server.control.ask("fault", name=name, **fields)
        clock.sleep(TICK_S)

    return fault


@pytest.fixture
def moving(server, connect):
    """A client whose arm is on its way."""
    client = connect()
    for line in ("jRelVel_0.05_", TARGET, "doPTPinJS"):
        assert client.ask(line) == "done\n"
    clock.sleep(0.5)
    assert joint(server) > 0.01
    return client


def joint(server):
    return server.control.ask("state")["joints"][0]


def stands(server):
    clock.sleep(BRAKES_S)
    return not any(server.control.ask("state")["velocities"])


def times_of(client, count):
    """When so many pieces come [s]."""
    times = []
    for _ in range(count):
        client.socket.recv(4096)
        times.append(clock.monotonic())
    return times


def test_half_open(server, moving, fault):
    fault("half_open")
    before = joint(server)
    moving.send("getJointsPositions\n")
    assert moving.silent(0.5)
    assert joint(server) > before + 0.01, "the arm continues"
    fault("half_open", on=False)
    assert moving.hear().count("_") == 7, "what was sent meanwhile is answered at the end"


def test_silent(server, connect, fault):
    client = connect()
    fault("silent")
    client.send("blueOn\n")
    assert client.silent(1.0)
    assert server.control.ask("state")["outputs"]["blue"], "the command was followed"
    fault("silent", on=False)
    assert client.ask() == ZEROS


def test_silent_for_a_share_of_the_answers(connect, fault):
    client = connect()
    fault("silent", value=0.5)
    client.send("getPin3\n" * 100)
    clock.sleep(TICK_S)
    fault("silent", on=False)
    client.send("getJointsPositions\n")
    answers = 0
    while client.hear() != ZEROS:
        answers += 1
    assert 80 < answers < 120, "of 200 lines"


def test_slow(connect, fault):
    client = connect()
    assert client.ask() == ZEROS
    fault("slow", value=0.5)
    begin = clock.monotonic()
    client.send("getJointsPositions\n")
    clock.sleep(0.05)
    client.send("blueOn\n")
    assert client.hear() == ZEROS and clock.monotonic() - begin == pytest.approx(0.5 + 2.0 * DELAY_S)
    assert client.hear() == "done\n" and clock.monotonic() - begin == pytest.approx(0.55 + 2.0 * DELAY_S)
    client.send("getJointsPositions\n")
    fault("slow", on=False)
    assert client.ask("blueOn") == ZEROS, "answers keep their order"
    assert client.hear() == "done\n"


def test_garbled(connect, fault):
    client = connect()
    fault("garbled")
    garbage = client.ask()
    assert garbage != ZEROS
    assert garbage.count("\n") == 1
    assert len(garbage) == len(ZEROS)
    fault("garbled", on=False)
    assert client.ask() == ZEROS


def test_torn(connect, fault):
    client = connect()
    fault("torn", value=0.01)
    begin = clock.monotonic()
    client.send("getJointsPositions\n")
    times = times_of(client, len(ZEROS))
    assert [at - begin for at in times] == pytest.approx([2.0 * DELAY_S + 0.01 * i for i in range(len(ZEROS))])
    fault("torn", on=False)
    assert client.ask() == ZEROS


def test_bursts(connect, fault):
    client = connect()
    fault("bursts", value=0.5)
    clock.sleep(math.ceil(2.0 * clock.monotonic()) / 2.0 + 0.1 - clock.monotonic())
    begin = clock.monotonic()
    for _ in range(3):
        client.send("getJointsPositions\n")
        clock.sleep(0.02)
    assert client.socket.recv(4096) == 3 * ZEROS.encode()
    assert clock.monotonic() - begin == pytest.approx(0.4 + DELAY_S)
    fault("bursts", on=False)
    assert client.ask() == ZEROS


def test_nagle(wires, connect, fault):
    client = connect()
    assert client.ask() == ZEROS
    down = wires.connections[-1].down
    assert not down.nagle
    fault("nagle")
    assert down.nagle and client.ask() == ZEROS
    fault("nagle", on=False)
    assert not down.nagle


def test_window(server, connect, fault):
    client = connect()
    fault("window", value=0.2)
    clock.sleep(1.0)
    assert client.ask() == ZEROS, "a client that is there may stay"
    client.send("end\n")
    clock.sleep(0.19)
    connect().close()
    clock.sleep(0.1)
    client = connect()
    assert client.ask() == ZEROS, "so may one that comes in time"
    client.send("end\n")
    clock.sleep(0.2 + 2 * TICK_S)
    with pytest.raises(ConnectionRefusedError):
        connect()
    fault("window", on=False)
    assert connect().ask() == ZEROS, "the same port"


def test_restarted(server, connect, moving, fault):
    fault("restarted")
    assert moving.at_end()
    assert stands(server)
    with pytest.raises(ConnectionRefusedError):
        connect()
    fault("restarted", on=False)
    clock.sleep(TICK_S)
    assert connect().ask() != "", "the same port"


def test_refused(server, connect, fault):
    client = connect()
    for line in ("TFtrans_0_0_100_0_0_0", "jRelVel_0.5_", TARGET):
        assert client.ask(line) == "done\n"
    fault("refused")
    assert client.ask("doPTPinJS") == "done\n"
    assert client.hear() == "nak\n"
    assert client.ask("Eef_pos").startswith("0.0_0.0_1301.0"), "the tool is off"
    fault("refused", on=False)
    assert client.ask("doPTPinJS") == "done\n"
    assert client.hear() == "done\n"
    assert joint(server) == 0.3


@pytest.mark.ros
def test_faults_of_the_command_line_are_there_from_the_start(virtual_graph):
    faults = ("--fault", "cut", "--fault", "slow:60:0.5")
    program = virtual_graph.run("rig_simulation", "sunrise_controller.py", "--control-port", "7001", *faults)
    clock.sleep(1.0)
    with ControlClient("127.0.0.1", 7001) as control:
        active = {entry["name"]: entry["left"] for entry in control.ask("faults")["faults"] if entry["on"]}
    assert active == {"cut": None, "slow": pytest.approx(59.0, abs=0.01)}
    assert program.poll() is None

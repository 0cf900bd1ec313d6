"""The program world.py on its wires: ready lines, requests, one clock, and a safety stop by what the arm touches."""

import contextlib
import re
import signal
import socket
import sys
from pathlib import Path

import numpy as np
import pytest

from common.errors import DeviceError
from rig_simulation.control_port import ControlClient
from rig_simulation.files import read_scene
from rig_simulation.world.program import main

SCRIPT = Path(__file__).parents[1] / "scripts" / "world.py"
FREE_PORTS = [text for name in ("", "control-", "hand-", "hand-control-", "world-") for text in (f"--{name}port", "0")]
HOME = np.radians([-45, 30, 0, -80, 0, 70, 0])
INTO_THE_TABLE = np.radians([-45, 60, 0, -80, 0, 70, 0])
TORQUE_LIMIT = 25.0


class Program:
    """A running world with a client on each of its ports."""

    def __init__(self, process, wait_until, resources):
        def ready():
            text = process.log_path.read_text()
            assert process.poll() is None, text
            return re.search(r"^world: scene \S+, control port 127.0.0.1:(\d+)$", text, re.MULTILINE)

        world = wait_until(ready, 60.0, "the world")
        text = process.log_path.read_text()
        arm = re.search(r"^sunrise_controller: listening on 127.0.0.1:(\d+), control port 127.0.0.1:(\d+)$", text, re.M)
        hand = re.search(r"^reflex_hand: on lo, UDP port (\d+), control port 127.0.0.1:(\d+)$", text, re.M)
        self.process = process
        self.port = int(arm[1])
        clients = (ControlClient("127.0.0.1", int(p), 60.0) for p in (world[1], arm[2], hand[2]))
        self.world, self.arm, self.hand = (resources.enter_context(client) for client in clients)
        self._resources = resources
        self._wire = None

    def tell(self, line):
        """Sends a line to the toolbox server and returns the line that it answers."""
        if self._wire is None:
            connection = self._resources.enter_context(socket.create_connection(("127.0.0.1", self.port), 60.0))
            self._wire = connection.makefile("rw", newline="\n")
        self._wire.write(line + "\n")
        self._wire.flush()
        return self.hear()

    def hear(self):
        return self._wire.readline().strip()

    def step(self, seconds):
        for _ in range(round(seconds / 0.1)):
            self.world.ask("step", count=100)

    def start_motion(self, q, speed):
        """Starts a joint motion at a relative speed; its last word is still to come."""
        assert self.tell(f"jRelVel_{speed}_") == "done"
        assert self.tell(goal(q)) == "done"
        assert self.tell("doPTPinJS") == "done"


def goal(q):
    return f"jp_{'_'.join(repr(float(value)) for value in q)}_"


@pytest.fixture
def start(processes, wait_until):
    """Starts the program on free ports."""
    with contextlib.ExitStack() as resources:

        def start(*arguments):
            process = processes.start(sys.executable, str(SCRIPT), *FREE_PORTS, *arguments)
            return Program(process, wait_until, resources)

        yield start


OTHER_RIG = ("--robot", "LBR14R820", "--flange", "MF_touch_pneumatisch", "--panel", "bundle", "--scene", "objects")


def assert_it_ends_without_a_traceback(program, number):
    program.process.send_signal(number)
    assert program.process.wait(20.0) == 0
    assert "Traceback" not in program.process.log_path.read_text()


def test_it_says_when_its_devices_are_ready_and_ends_when_it_is_terminated(start):
    assert_it_ends_without_a_traceback(start(*OTHER_RIG), signal.SIGTERM)


def test_one_clock_moves_arm_hand_and_objects_by_itself_until_an_interrupt(start, wait_until):
    program = start("--scene", "objects", "--speed", "2")
    wait_until(lambda: program.world.ask("state")["time"] > 1.0, 60.0, "a second of the world")
    state, hand = program.world.ask("state"), program.hand.ask("state")
    assert not state["stepped"]
    ages = [program.arm.ask("state")["age"] for _ in range(10)]
    assert -1e-3 < min(ages) < 0.5, "by the world's clock, which is seconds away from the machine's"
    assert state["time"] - 5.0 < hand["time"] < program.world.ask("state")["time"] + 5.0
    objects = program.world.ask("objects")["objects"]
    assert {name for name, one in objects.items() if one["touches"] == ["table"]} == set(objects)
    assert all("table" in contact["bodies"] for contact in program.world.ask("contacts")["contacts"])
    with pytest.raises(DeviceError):
        program.world.ask("step")
    assert_it_ends_without_a_traceback(program, signal.SIGINT)


def test_time_that_is_stepped_stands_still_otherwise(start):
    program = start("--stepped")
    assert program.world.ask("state")["steps"] == 0
    for _ in range(3):
        program.arm.ask("state")
        program.hand.ask("state")
    assert program.world.ask("state")["time"] == 0.0
    assert program.world.ask("step")["steps"] == 1
    assert program.world.ask("step", count=999)["time"] == pytest.approx(1.0)
    arm = program.arm.ask("state")
    assert (arm["time"], arm["age"]) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert program.hand.ask("state")["time"] == pytest.approx(1.0)
    for count in (0, 1001, 1.5, True, "many"):
        with pytest.raises(DeviceError):
            program.world.ask("step", count=count)


def session(program):
    """Moves the arm home and then in servo mode over the table; returns all states on the way."""
    seen = []
    program.start_motion(HOME, 0.3)
    for _ in range(30):
        program.step(0.1)
        seen.append(program.world.ask("snapshot")["qpos"])
    assert program.hear() == "done"
    assert program.tell("startDirectServoJoints") == "done"
    program.step(0.4)
    for i in range(20):
        assert program.tell(goal(HOME + 0.2 * np.sin(0.1 * i))) == "done"
        program.world.ask("step", count=20)
        seen.append(program.world.ask("snapshot")["qpos"])
    return np.array(seen)


def test_the_same_commands_in_stepped_time_lead_to_the_very_same_numbers(start):
    first = session(start("--stepped", "--scene", "scattered", "--seed", "5"))
    np.testing.assert_array_equal(session(start("--stepped", "--scene", "scattered", "--seed", "5")), first)
    other = session(start("--stepped", "--scene", "scattered", "--seed", "6"))
    assert not np.array_equal(other, first)
    np.testing.assert_allclose(other[:, :7], first[:, :7], atol=1e-9, err_msg="the arm goes its way in any scene")


def test_pressing_on_the_table_stops_the_arm_and_after_backing_off_it_continues(start):
    program = start("--stepped", "--scene", "empty")
    program.start_motion(HOME, 0.3)
    program.step(3.0)
    assert program.hear() == "done"
    program.start_motion(INTO_THE_TABLE, 0.15)
    program.step(5.0)
    state = program.arm.ask("state")
    assert re.match(r"The external torque of joint \d is .* Nm \(limit 25\)", state["safety_stop"])
    assert (state["mode"], state["stops"]) == ("ptp", 1)
    assert not np.any(state["velocities"])
    external = np.array(program.tell("jpExT_" + goal(HOME)[3:]).strip("_").split("_"), dtype=float)
    assert np.abs(external).max() > TORQUE_LIMIT
    with pytest.raises(DeviceError):
        program.arm.ask("release")
    program.arm.ask("back_off")
    program.step(3.0)
    lower = read_scene("empty")
    lower["table"]["top"] = -0.5
    program.world.ask("set_scene", scene=lower)
    program.arm.ask("release")
    program.step(6.0)
    assert program.hear() == "done"
    np.testing.assert_allclose(program.arm.ask("state")["joints"], INTO_THE_TABLE, atol=1e-9)
    assert program.arm.ask("state")["stops"] == 1


def test_a_client_sees_the_stop_and_the_release_in_time_that_runs(start, wait_until):
    kst = pytest.importorskip("kst")
    program = start("--scene", "empty")
    patient = kst.KstTiming(reply=20.0, servo_reply=20.0)
    client = kst.KstClient.connect("127.0.0.1", program.port, tool=np.eye(4), timeout=60.0, timing=patient)
    client.ptp_joints(HOME, 0.3, 60.0)
    client.start_ptp_joints(INTO_THE_TABLE, 0.15)
    wait_until(lambda: program.arm.ask("state")["safety_stop"], 60.0, "the safety stop")
    wait_until(lambda: not np.any(program.arm.ask("state")["velocities"]), 30.0, "the arm to stand")
    stood = client.joints()
    assert not client.ptp_arrived()
    program.arm.ask("back_off")
    wait_until(lambda: client.joints()[1] < stood[1] - 1e-3, 30.0, "the way back")
    wait_until(lambda: not np.any(program.arm.ask("state")["velocities"]), 30.0, "the arm to stand")
    lower = read_scene("empty")
    lower["table"]["top"] = -0.5
    program.world.ask("set_scene", scene=lower)
    program.arm.ask("release")
    wait_until(client.ptp_arrived, 60.0, "the end of the motion")
    np.testing.assert_allclose(client.joints(), INTO_THE_TABLE, atol=1e-9)
    client.close()


def test_the_objects_can_be_put_back_and_exchanged(start):
    program = start("--stepped", "--scene", "cup")
    program.step(0.5)
    before = program.world.ask("snapshot")
    program.world.ask("reset")
    after = program.world.ask("snapshot")
    assert after["loads"] == before["loads"]
    assert after["qpos"] != before["qpos"], "it starts a little above the table"
    assert program.world.ask("set_scene", scene="objects") == {"loads": 2}
    assert len(program.world.ask("snapshot")["qpos"]) == len(before["qpos"]) + 4 * 7
    assert program.world.ask("scene")["scene"] == read_scene("objects")
    for scene, sentence in (("kitchen", "'kitchen'"), ({"table": 3}, "table is 3"), (7, "configuration is 7")):
        with pytest.raises(DeviceError, match=sentence):
            program.world.ask("set_scene", scene=scene)
    assert program.world.ask("state")["loads"] == 2


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        (["--scene", "kitchen"], "'kitchen'"),
        (["--panel", "wall"], "'wall'"),
        (["--speed", "-1"], "'-1'"),
        (["--mounting", "0", "90", "0"], "room"),
        (["--interface", "none9"], "'none9'"),
        (["--sceen", "cup"], "unknown arguments: --sceen cup"),
    ],
)
def test_bad_arguments_are_one_sentence(capsys, arguments, key):
    with pytest.raises(SystemExit) as end:
        sys.exit(main([*FREE_PORTS, *arguments]))
    assert end.value.code == 1
    text = capsys.readouterr().err
    assert key in text
    assert text.startswith("world: ")
    assert text.count("\n") == 1

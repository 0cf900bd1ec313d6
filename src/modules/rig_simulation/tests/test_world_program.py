"""The program world.py on its wires in virtual time: requests, one clock, a safety stop by what the arm touches."""

import re
import signal
import sys

import numpy as np
import pytest

from common import clock
from common.errors import DeviceError
from rig_simulation.control_port import ControlClient
from rig_simulation.files import read_scene
from rig_simulation.world.program import main

HOME = np.radians([-45, 30, 0, -80, 0, 70, 0])
INTO_THE_TABLE = np.radians([-45, 60, 0, -80, 0, 70, 0])
TORQUE_LIMIT = 25.0
TICK_S = 0.02
"""How often the server looks after an arm at rest."""
READY = re.compile(
    r"sunrise_controller: listening on 127.0.0.1:(\d+), control port 127.0.0.1:(\d+)\n"
    r"reflex_hand: on lo, UDP port (\d+), control port 127.0.0.1:(\d+)\n"
    r"world: scene \S+, control port 127.0.0.1:(\d+)\n"
)


class Program:
    """A running world with a client on each of its ports."""

    def __init__(self, graph, *arguments):
        self._graph, self._wire = graph, None
        names = ("", "control-", "hand-", "hand-control-", "world-")
        free = [text for name in names for text in (f"--{name}port", "0")]
        self.process = graph.run("rig_simulation", "world.py", *free, *arguments)
        clock.sleep(0.01)
        ready = READY.fullmatch(self.process.log)
        assert ready, self.process.log
        self.port, arm, self.hand_port, *others = map(int, ready.groups())
        self.arm, self.hand, self.world = (ControlClient("127.0.0.1", port) for port in (arm, *others))

    def tell(self, line):
        """Sends a line to the toolbox server and returns the line that it answers."""
        if self._wire is None:
            self._wire = self._graph.wires.connect(("127.0.0.1", self.port), 60.0)
            self._replies = self._wire.makefile("rb")
        self._wire.sendall(f"{line}\n".encode())
        return self.hear()

    def hear(self):
        return self._replies.readline().decode().strip()

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
def start(virtual_graph, network):
    """Starts the program on free ports."""
    return lambda *arguments: Program(virtual_graph, *arguments)


OTHER_RIG = ("--robot", "LBR14R820", "--flange", "MF_touch_pneumatisch", "--panel", "bundle", "--scene", "objects")


@pytest.mark.ros
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_says_when_its_devices_are_ready_and_ends_on_a_signal(start, number):
    process = start(*OTHER_RIG).process
    said = process.log
    process.send_signal(number)
    assert process.wait(TICK_S + 0.01) == 0 and process.log == said


@pytest.mark.ros
def test_one_clock_moves_arm_hand_and_objects_by_itself(start, network):
    program = start("--scene", "objects", "--speed", "2")
    host = network.connect("lo", program.hand_port)
    begin = program.world.ask("state")["time"]
    clock.sleep(1.0)
    state, hand, arm = (device.ask("state") for device in (program.world, program.hand, program.arm))
    assert state["time"] - begin == pytest.approx(2.0, abs=0.01) and not state["stepped"]
    assert hand["time"] == pytest.approx(state["time"], abs=0.03) and arm["age"] == pytest.approx(0.0, abs=1e-3)
    assert state["real_time_factor"] == pytest.approx(2.0, abs=0.02)
    packets = list(iter(lambda: host.packets.get(0.0), None))
    assert len(packets) == pytest.approx(80, abs=1), "every 25 ms of the world"
    objects = program.world.ask("objects")["objects"]
    assert {name for name, one in objects.items() if one["touches"] == ["table"]} == set(objects)
    assert all("table" in contact["bodies"] for contact in program.world.ask("contacts")["contacts"])
    with pytest.raises(DeviceError):
        program.world.ask("step")


@pytest.mark.ros
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


@pytest.mark.ros
def test_the_same_commands_in_stepped_time_lead_to_the_very_same_numbers(start):
    first = session(start("--stepped", "--scene", "scattered", "--seed", "5"))
    np.testing.assert_array_equal(session(start("--stepped", "--scene", "scattered", "--seed", "5")), first)
    other = session(start("--stepped", "--scene", "scattered", "--seed", "6"))
    assert not np.array_equal(other, first)
    np.testing.assert_allclose(other[:, :7], first[:, :7], atol=1e-9, err_msg="the arm goes its way in any scene")


@pytest.mark.ros
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


@pytest.mark.ros
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
        (["--mounting", "0", "90", "0"], "room"),
        (["--interface", "none9"], "'none9'"),
    ],
)
def test_bad_arguments_are_one_sentence(capsys, arguments, key):
    with pytest.raises(SystemExit) as end:
        sys.exit(main(arguments))
    assert end.value.code == 1
    text = capsys.readouterr().err
    assert key in text
    assert text.startswith("world: ")
    assert text.count("\n") == 1

"""The simulated robot application in the physics: soft springs, a floating arm, a hand that guides it, load check and
limits. A force of 10 N at the tool is what a hand applies."""

from __future__ import annotations

import numpy as np
import pytest
from test_leap_rig import Client
from test_world_arm import HOME, solved

from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.leap_rig import LeapRigApplication
from rig_simulation.files import read_scene
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.parts import ArmJoints, HandPart
from rig_simulation.world.physics import World

JOINTS = "lrSoftJoints_300_300_300_300_200_100_50_0.7_"
TOOL = "lrSoftTool_500_500_500_100_100_100_0.7_20_40_20_200_1_"
PUSH = np.array([10.0, 0.0, 0.0])


class Soft(Client):
    """A client whose tool's mass the controller knows, with the arm at home: by itself, or in a world over a table."""

    def __init__(self, world=False, mass=1.0, **settings):
        super().__init__(tool_weight=True, **settings)
        if world:
            world = World(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), read_scene("empty")))
            self.world = world
            world.add(HandPart())
            self.arm = SimulatedArm(self.arm.robot, ArmSettings(tool_weight=True), ArmJoints(world))
            self.application = LeapRigApplication(self.arm, self.panel)
            self.one("lrHello_1_")
            self.one("jRelVel_0.3_")
            self.one(line(HOME))
            self.one("doPTPinJS")
            self.live(6.0)
            assert "done\n" in self.take()
        else:
            self.arm.q = HOME
        body = self.arm.hand
        centre = "_".join(str(1000.0 * x) for x in body.com)
        assert self.one(f"lrTool_{mass * body.mass}_{centre}_0_0_200_0_0_0_").startswith("ok_")
        self.take()

    def serve(self, softness):
        assert self.one(softness).startswith("ok_lrSoft")
        assert self.one("startDirectServoJoints") == "done\n"
        self.live(0.2)
        self.take()

    def shift(self, T):
        """Returns how far the tool is from a pose, along its axes [m]."""
        return (np.linalg.inv(T) @ self.arm.tool)[:3, 3]


def line(q):
    return f"jp_{'_'.join(map(str, q.tolist()))}_"


@pytest.mark.hazard(27)
def test_softness_needs_a_known_mass_the_load_check_and_rest():
    client = Client()
    assert client.one(JOINTS) == "no_lrSoftJoints_the tool's mass is not known: say lrTool first\n".replace(
        "t\n", "t_\n"
    )
    assert client.one("lrFloat_").startswith("no_lrFloat_the tool's mass")
    wrong = Soft(mass=0.2)
    refused = "the controller's load check fails: mass, centre or pose are wrong_\n"
    assert wrong.one(TOOL) == f"no_lrSoftTool_{refused}"
    assert wrong.one("lrFloat_") == f"no_lrFloat_{refused}"
    right = Soft()
    assert right.one("lrSoftJoints_6000_0_0_0_0_0_0_0.7_").startswith("no_lrSoftJoints_a joint's stiffness is 6000.0")
    assert right.one("lrSoftTool_1_1_1_301_1_1_0.7_1_10_5_50_0.5_").startswith("no_lrSoftTool_a stiffness about")
    assert right.one("lrSoftTool_1_1_1_300_1_1_0.7_1_10_5_50_3_").startswith(
        "no_lrSoftTool_the path's deviation in rad"
    )
    right.serve(TOOL)
    assert right.events()[-1] == "servo mode begins, TOOL"
    assert right.one("lrStiff_") == "no_lrStiff_the arm is not at rest_\n"
    right.one("stopDirectServoJoints")
    right.live(0.2)
    right.take()
    assert right.one("lrStiff_") == "ok_lrStiff_\n" and right.one("startDirectServoJoints") == "done\n"
    assert right.events()[-1] == "servo mode begins"


@pytest.mark.parametrize("world", [False, True])
def test_springs_at_the_tool_give_way_by_their_stiffness_and_return(world):
    client = Soft(world)
    client.serve(TOOL)
    T = client.arm.tool
    client.live(0.3)
    assert client.shift(T) == pytest.approx(np.zeros(3), abs=3e-4), "it does not sink"
    client.arm.set_tool_force(PUSH)
    client.live(2.0)
    assert client.shift(T) == pytest.approx(PUSH / 500.0, abs=1e-3)
    client.arm.set_tool_force(np.zeros(3))
    client.live(2.0)
    assert client.shift(T) == pytest.approx(np.zeros(3), abs=1e-3)


def test_springs_at_the_joints_give_way_by_their_stiffness():
    client = Soft()
    client.serve(JOINTS)
    q = client.arm.q
    client.arm.set_external_torque(np.array([9.0, 0, 0, -6.0, 0, 0, 0]))
    client.live(2.0)
    assert client.arm.q - q == pytest.approx(np.array([0.03, 0, 0, -0.02, 0, 0, 0]), abs=1e-3)
    client.one(line(q + 0.05))
    client.arm.set_external_torque(np.zeros(7))
    client.live(2.0)
    assert client.arm.q == pytest.approx(q + 0.05, abs=1e-3), "and it follows goals"


def test_a_load_that_nobody_stated_pulls_a_soft_arm_down_and_one_that_is_stated_does_not():
    sunk = []
    for stated in (False, True):
        client = Soft()
        if stated:
            client.one("lrLoad_0.4_0_0_200_")
        weight = client.arm.robot.weight(client.arm.q, 0.4, np.array([0.0, 0.0, 0.2]))
        client.serve(TOOL)
        z = client.arm.tool[2, 3]
        client.arm.set_external_torque(weight)
        client.live(2.0)
        sunk.append(z - client.arm.tool[2, 3])
    assert sunk[0] == pytest.approx(0.4 * 9.81 / 500.0, abs=3e-3) and abs(sunk[1]) < 3e-3


def pressed(client, depth, stop=lambda: False):
    """Moves the goal down by so much in steps of 1 mm; returns the force on the table [N]."""
    flange, goal = client.arm.robot.flange(client.arm.goal), client.arm.goal
    for k in range(round(1000.0 * depth)):
        target = flange.copy()
        target[2, 3] -= 0.001 * (k + 1)
        goal = solved(client.arm.robot, target, goal)
        client.one(line(goal))
        client.live(0.01)
        client.take()
        if stop() or client.application.phase != "SERVO":
            break
    client.live(0.5)
    client.take()
    return force(client)


def force(client):
    return sum(contact["force"] for contact in client.world.contacts())


def test_a_soft_arm_presses_on_a_table_by_its_stiffness_and_stops_at_its_limits():
    client = Soft(world=True)
    client.serve(TOOL)
    pressed(client, 0.4, lambda: force(client) > 2.0)
    assert client.application.phase == "SERVO"
    before = client.arm.tool[2, 3]
    first = pressed(client, 0.02)
    second = pressed(client, 0.02)
    assert second - first == pytest.approx(0.02 * 500.0, rel=0.2), "500 N/m"
    assert client.arm.tool[2, 3] == pytest.approx(before, abs=0.006) and client.arm.safety_stop is None
    client.events()
    pressed(client, 0.12)
    assert client.events() == ["servo mode ends: the controller gave up"] and "the force is" in client.arm.gave_up


@pytest.mark.parametrize("softness", [JOINTS, TOOL])
def test_a_soft_arm_brakes_at_the_watchdog_and_stops_when_asked(softness):
    client = Soft()
    client.serve(softness)
    goal = client.arm.goal.copy()
    for _ in range(60):
        goal[0] += 0.003
        client.one(line(goal))
    assert client.arm.v[0] > 0.15
    client.take()
    client.wait(0.201)
    assert client.events()[-1] == "the arm brakes and holds: the client was silent"
    speed = client.arm.v[0]
    client.wait(0.02)
    assert client.arm.v[0] < 0.95 * speed
    client.wait(1.0)
    assert np.max(np.abs(client.arm.v)) < 5e-3
    client.application.stop()
    client.wait(0.15)
    assert client.arm.resting and client.events() == ["servo mode ends: the client"]


def test_a_floating_arm_moves_by_hand_does_not_sink_and_is_stiff_without_its_client():
    client = Soft()
    assert client.one("lrFloat_") == "ok_lrFloat_\n"
    client.live(1.0)
    assert client.arm.q == pytest.approx(HOME, abs=1e-6)
    client.arm.set_tool_force(PUSH)
    client.live(0.5)
    moved = client.arm.tool_speed
    assert moved > 0.02
    client.wait(0.4)
    assert client.events()[-1] == "servo mode ends: the watchdog" and client.arm.resting


@pytest.mark.hazard(28)
def test_a_hand_guides_the_arm_while_the_enabling_switch_is_pressed():
    client = Soft()
    assert client.one("lrGuide_") == "ok_lrGuide_\n"
    client.arm.set_tool_force(PUSH)
    client.live(0.5)
    assert client.arm.q == pytest.approx(HOME) and client.application.phase == "MOTION"
    client.arm.enabling = True
    client.live(0.5)
    client.take()
    assert client.one("lrState_").endswith("_HANDGUIDING_NOSTOP_\n")
    assert client.arm.tool_speed > 0.02
    client.arm.enabling = False
    begin = client.now
    client.until(lambda: not client.arm.v.any())
    assert client.now - begin < 0.1, "its release stops the arm"
    assert client.wait_for_reply() == "done\n" and np.max(np.abs(client.arm.q - HOME)) > 0.01


@pytest.mark.parametrize(
    ("halt", "why"),
    [
        (lambda client: client.application.stop(), "the client"),
        (lambda client: client.arm.press_emergency_stop(True), "a safety stop, STOP1"),
        (lambda client: client.wait(0.3), "the watchdog"),
    ],
)
def test_hand_guiding_is_stopped_like_any_motion(halt, why):
    client = Soft()
    client.one("lrGuide_")
    client.arm.enabling = True
    client.arm.set_tool_force(PUSH)
    client.live(0.5)
    client.take()
    halt(client)
    client.wait(0.15)
    assert client.take() == [f"stopped_{why}_\n"] and client.arm.resting

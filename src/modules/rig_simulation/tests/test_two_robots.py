"""Two robots in one physics: names, contacts between them, and their arms and hands on wires of their own."""

import re
import signal
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from common import clock
from common.errors import ConfigError
from common.poses import pose
from common.rotations import rotation_from_zyx
from kst import KstClient
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.paths import JointMove
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.files import read_board, read_scene, read_urdf
from rig_simulation.world.model import WorldDescription, build_model
from rig_simulation.world.parts import ArmJoints, CarriedJoints, HandPart
from rig_simulation.world.physics import World
from rig_simulation.world.program import _of_robot, _options, main

ARMS = {
    "margin": 0.3,
    "left": {"position": [0.1, 0.45, 0.2], "rpy": [0, 0, 30]},
    "right": {"position": [0, -0.45, 0]},
}
KIND, DT = ("LBR7R800", "MF_elektrisch"), 1e-3
SHIPPED = Path(__file__).parents[3] / "kuka_control" / "config" / "two_arms.yaml"
HOME = np.radians([0, 30, 0, -80, 0, 70, 0])


def description(arms, scene="empty", panel=None, panel_arm=""):
    return WorldDescription(*KIND, (0.0, 0.0, 0.0), read_scene(scene), panel, arms, panel_arm)


def robot_bodies(model, prefix):
    names = [model.body(i).name for i in range(model.nbody)]
    return [name for name in names if re.match(rf"{prefix}(kuka/|reflex/|panel)", name)]


def touches(model, one, other):
    return bool(
        model.geom(one).contype[0] & model.geom(other).conaffinity[0]
        or model.geom(other).contype[0] & model.geom(one).conaffinity[0]
    )


def test_each_robot_is_the_only_one_behind_its_prefix_and_where_it_stands():
    alone, two = build_model(description(None), False), build_model(description(ARMS), False)
    data = mujoco.MjData(alone), mujoco.MjData(two)
    for model, state in zip((alone, two), data):
        for joint in range(7):
            for prefix in ("",) if model is alone else ("left/", "right/"):
                model_joint = model.joint(f"{prefix}kuka/joint_{joint + 1}")
                state.qpos[model_joint.qposadr[0]] = 0.1 * joint
        mujoco.mj_forward(model, state)
    links = robot_bodies(alone, "")
    assert len(links) > 15
    for prefix, T in (("left/", placed(ARMS["left"])), ("right/", placed(ARMS["right"]))):
        assert robot_bodies(two, prefix) == [prefix + name for name in links]
        for name in links:
            here, there = data[0].body(name), data[1].body(prefix + name)
            np.testing.assert_allclose(there.xpos, T[:3, :3] @ here.xpos + T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(there.xmat.reshape(3, 3), T[:3, :3] @ here.xmat.reshape(3, 3), atol=1e-12)
            assert two.body(prefix + name).mass == alone.body(name).mass
    assert two.nu == 2 * alone.nu and two.ntendon == 2 * alone.ntendon and two.nexclude == 2 * alone.nexclude


def placed(values):
    roll, pitch, yaw = np.radians(values.get("rpy", [0, 0, 0]))
    return pose(rotation_from_zyx(yaw, pitch, roll), values["position"])


def test_the_parts_of_one_robot_touch_those_of_the_other_and_of_their_own_as_when_alone():
    alone, two = build_model(description(None), False), build_model(description(ARMS), False)

    geoms = [alone.geom(i).name for i in range(alone.ngeom)]
    solid = [name for name in geoms if alone.geom(name).contype[0]]
    robot = [name for name in solid if name.startswith(("kuka/", "reflex/"))]
    assert len(robot) > 20
    for one in robot:
        for other in robot:
            assert touches(two, f"left/{one}", f"right/{other}")
            for prefix in ("left/", "right/"):
                assert touches(two, prefix + one, prefix + other) == touches(alone, one, other)
        for other in set(solid) - set(robot):
            for prefix in ("left/", "right/"):
                assert touches(two, prefix + one, other) == touches(alone, one, other)


@pytest.mark.parametrize(("side", "other"), [("left", "right"), ("right", "left")])
def test_one_of_both_arms_holds_the_marker_board_on_its_ring_and_the_board_touches_the_other(side, other):
    alone = build_model(description(None, panel=read_board("bundle")), False)
    two = build_model(description(ARMS, panel=read_board("bundle"), panel_arm=side), False)
    with_board = robot_bodies(two, f"{side}/")
    assert set(with_board) - {name.replace(other, side) for name in robot_bodies(two, f"{other}/")} == {
        f"{side}/kuka/marker_connector",
        f"{side}/panel",
    }
    held, only = two.body(f"{side}/panel"), alone.body("panel")
    assert two.body(held.parentid[0]).name == f"{side}/kuka/flange"
    np.testing.assert_array_equal([*held.pos, *held.quat], [*only.pos, *only.quat])
    plate, link = f"{side}/panel/plate", "kuka/link_3/collision_0"
    assert touches(two, plate, f"{other}/{link}") and touches(two, plate, "table")
    assert not touches(two, plate, f"{side}/{link}")


@pytest.mark.parametrize(
    ("arms", "panel", "panel_arm", "sentence"),
    [
        (ARMS, "single", "", "panel_arm is '', but must be left or right"),
        (ARMS, "single", "top", "panel_arm is 'top', but must be left or right"),
        (None, "single", "left", "panel_arm is 'left', but must be left out"),
        (ARMS, None, "left", "panel_arm is 'left', but there is no marker board"),
        ({**ARMS, "left": {"position": [0, 99, 0]}}, None, "", "arms/left/position is"),
    ],
)
def test_a_marker_board_that_no_arm_holds_or_bad_arms_are_refused(arms, panel, panel_arm, sentence):
    with pytest.raises(ConfigError, match=sentence):
        build_model(description(arms, panel=panel and read_board(panel), panel_arm=panel_arm), False)


class TwoArms:
    """Two arms with hands in a world; the left one drives the time."""

    def __init__(self, arms, pairs=True):
        self.world = World(description(arms))
        self.hands = [HandPart(0, prefix) for prefix in ("left", "right")]
        for hand in self.hands:
            self.world.add(hand)
        driver, carried = ArmJoints(self.world, pairs, "left"), CarriedJoints(self.world, "right")
        model, settings = Robot(read_urdf(*KIND)), ArmSettings(servo_law="none")
        self.left, self.right = SimulatedArm(model, settings, driver), SimulatedArm(model, settings, carried)
        driver.carry(carried, self.right.step)

    def go(self, left, right, share=0.2):
        for arm, q in ((self.left, left), (self.right, right)):
            if q is not None:
                arm.start_motion(JointMove(arm.q, q, share * arm.robot.max_speed, arm.motion_acceleration))

    def run(self, seconds):
        for _ in range(round(seconds / DT)):
            self.left.step(DT)

    def joints(self, prefix):
        model, qpos = self.world.model, self.world.data.qpos
        return np.array([qpos[model.joint(f"{prefix}/kuka/joint_{i}").qposadr[0]] for i in range(1, 8)])


LEVEL = {"margin": 0.3, "left": {"position": [0, 0.45, 0]}, "right": {"position": [0, -0.45, 0]}}


@pytest.mark.parametrize("pairs", [True, False])
def test_both_arms_move_by_themselves_and_the_physics_follows_both(pairs):
    two, one = TwoArms(LEVEL, pairs), TwoArms(LEVEL, pairs)
    other = HOME + 0.2
    two.go(HOME, other)
    one.go(None, other)
    for rig in (two, one):
        rig.run(4.0)
        np.testing.assert_allclose(rig.right.q, other, atol=1e-9)
        np.testing.assert_allclose(rig.joints("right"), other, atol=2e-4)
        assert rig.world.time == pytest.approx(4.0, abs=2e-3)
        assert not rig.left.stops and not rig.right.stops
    np.testing.assert_allclose(two.joints("left"), HOME, atol=2e-4)
    np.testing.assert_allclose(one.joints("left"), 0.0, atol=2e-4)
    # What one arm does is nothing to the other: they share time, not forces.
    np.testing.assert_allclose(two.joints("right"), one.joints("right"), atol=1e-6)


def test_arms_that_collide_stop_each_other():
    """The left one stretches to the side where the right one stands, as no workspaces that keep apart let it."""
    two = TwoArms(LEVEL)
    two.go(np.radians([-90, 0, 0, 0, 0, 0, 0]), None)
    two.run(3.0)
    two.go(np.radians([-90, 85, 0, 0, 0, 0, 0]), None)
    two.run(4.0)
    assert two.left.stops and two.right.stops
    assert "external torque" in two.left.safety_stop and "external torque" in two.right.safety_stop
    touching = {tuple(sorted(name.split("/")[0] for name in contact["bodies"])) for contact in two.world.contacts()}
    assert ("left", "right") in touching


def test_the_scene_of_two_arms_has_a_box_within_the_reach_of_each():
    world = World(description(yaml.safe_load(SHIPPED.read_text()), "two_arms"))
    assert set(world.objects()) == {"left_box", "right_box"}
    for name, y in (("left_box", 0.45), ("right_box", -0.45)):
        x, there, _ = world.objects()[name].position
        assert there == pytest.approx(y) and 0.5 < x < 0.7  # straight ahead, between the spheres of the workspace


@pytest.mark.ros
def test_each_arm_and_each_hand_answers_on_its_own_wire(virtual_graph, network):
    ports = [text for name in ("", "control-", "hand-", "hand-control-", "world-") for text in (f"--{name}port", "0")]
    process = virtual_graph.run("rig_simulation", "world.py", *ports, "--arms", str(SHIPPED), "--scene", "two_arms")
    clock.sleep(0.01)
    ports = dict(re.findall(r"^(\w+)/sunrise_controller: listening on \S+:(\d+), control", process.log, re.M))
    controls = re.findall(r"^(\S+):.*, control port (\S+):(\d+)$", process.log, re.M)
    devices = {name: ControlClient(host, int(port)) for name, host, port in controls}
    names = ("sunrise_controller", "reflex_hand")
    assert list(ports) == ["left", "right"]
    assert set(devices) == {"world", *(f"{side}/{name}" for side in ports for name in names)}
    goals = {"left": HOME, "right": HOME + 0.1}
    for side in ports:
        client = KstClient.connect("127.0.0.1", int(ports[side]), tool=np.eye(4))
        client.ptp_joints(goals[side], 0.25, 10.0)
        for arm, q in goals.items():
            state = devices[f"{arm}/sunrise_controller"].ask("state")
            moved = arm == side or side == "right"
            np.testing.assert_allclose(state["joints"], q if moved else np.zeros(7), atol=1e-4)
        client.close()
    steps = devices["right/sunrise_controller"].ask("state")["time"]
    assert steps == pytest.approx(devices["world"].ask("state")["time"], abs=0.01), (
        "the right one counts the left one's"
    )
    before = {side: devices[f"{side}/reflex_hand"].ask("state")["positions"][0] for side in ports}
    devices["right/reflex_hand"].ask("jump", motor=0, turns=3)
    after = {side: devices[f"{side}/reflex_hand"].ask("state")["positions"][0] for side in ports}
    assert abs(after["left"] - before["left"]) < 100 < 1000 < abs(after["right"] - before["right"])
    objects = devices["world"].ask("objects")
    assert objects["frame"] == "world" and set(objects["objects"]) == {"left_box", "right_box"}
    process.send_signal(signal.SIGINT)
    assert process.wait(0.03) == 0 and "Traceback" not in process.log


def test_a_mounting_beside_arms_is_refused(capsys):
    assert main(["--arms", str(SHIPPED), "--mounting", "180", "0", "0"]) == 1
    assert "--mounting is [180.0, 0.0, 0.0] deg" in capsys.readouterr().err


@pytest.mark.parametrize(("given", "second"), [("47001", 47002), ("0", 0)])
def test_the_second_robot_has_the_ports_of_the_first_and_one_and_a_seed_and_mounting_of_its_own(given, second):
    keys = ("port", "control_port", "hand_port", "hand_control_port")
    options = _options([text for key in keys for text in (f"--{key.replace('_', '-')}", given)])
    first, other = (_of_robot(options, description(ARMS), prefix, n) for n, prefix in enumerate(("left", "right")))
    assert [getattr(first, key) for key in keys] == 4 * [int(given)]
    assert [getattr(other, key) for key in keys] == 4 * [second]
    assert (
        (first.seed, other.seed) == (0, 1) and list(first.mounting) == [0, 0, 30] and list(other.mounting) == [0, 0, 0]
    )
    assert _of_robot(options, description(None), "", 0) is options

"""The hand in the physics, alone and fixed in the air: fingers, servos, taxels, and what it can hold."""

import math
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from common.frames import BASE
from common.poses import pose
from leap_hand.force_limit import FingerFeedback, ForceLimit
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.mechanics import OVERLOAD_BIT
from rig_simulation.devices.reflex.wire import POSITION, ModeCommand, TargetCommand
from rig_simulation.files import read_urdf
from rig_simulation.world.hand_model import FLEXURE_RATIO, prepare_hand
from rig_simulation.world.mjcf import add_robot, numbers, quaternion
from rig_simulation.world.parts import COUNTS_PER_N, PhysicalMechanics
from rig_simulation.world.scene import Ball, Bottle, Cuboid, Cup, Cylinder, add_object

TIMESTEP_S = 0.001
CLOSING = np.array([1, -1, 1, -1])
TICKS_PER_RAD = np.array([1.42, 1.42, 1.42, 1.5]) * 1024 / (2 * math.pi)
GRIP = (2.4, 2.4, 2.2, 0.0)
LIMITS = {
    "force_limit_pressure": 60.0,
    "force_limit_load": 230.0,
    "force_limit_release": 0.5,
    "force_limit_silence": 0.5,
}
LOOK = {"position": np.zeros(2), "yaw": 0.0, "friction": 0.6, "colour": np.ones(3)}
THINGS = {
    "cup": Cup(radius=0.036, height=0.095, wall=0.004, mass=0.25, **LOOK),
    "box": Cuboid(size=np.array([0.06, 0.09, 0.07]), mass=0.15, **LOOK),
    "ball": Ball(radius=0.034, mass=0.06, **LOOK),
    "cylinder": Cylinder(radius=0.033, height=0.11, mass=0.25, **LOOK),
    "bottle": Bottle(radius=0.033, height=0.20, neck_radius=0.014, neck_height=0.06, mass=0.30, **LOOK),
}
# Orientation of the hand in the world, and pose of the thing in the hand.
LYING = pose(np.column_stack([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), (0.013, 0.0, 0.131))
HANGING = pose(np.diag([1.0, -1.0, -1.0]), (0.013, 0.0, 0.15))
PALM_DOWN = np.diag([1.0, -1.0, -1.0])
PALM_AHEAD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
FINGERS_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
GRASPS = {
    "upright, from the side": (PALM_AHEAD, LYING),
    "lying, from above": (PALM_DOWN, LYING),
    "lying, thumb below": (FINGERS_UP, LYING),
    "upright, from above": (PALM_DOWN, HANGING),
}


def hand_alone() -> str:
    """The URDF without the arm, the hand on the root."""
    root = ET.fromstring(read_urdf("LBR7R800", "MF_elektrisch"))
    for element in list(root):
        name = element.get("name", "")
        if element.tag in ("link", "joint") and not name.startswith("reflex/"):
            root.remove(element)
    root.find("joint[@name='reflex/connector']/parent").set("link", BASE)
    ET.SubElement(root, "link", name=BASE)
    return ET.tostring(root, encoding="unicode")


class Bench:
    """The hand in the air with one thing, which is held in its place until it is let go."""

    def __init__(self, R_world_hand=None, thing=None, T_hand_thing=None, seed=0):
        R = np.eye(3) if R_world_hand is None else R_world_hand
        root = ET.Element("mujoco")
        ET.SubElement(root, "compiler", angle="radian", autolimits="true")
        ET.SubElement(root, "option", timestep=str(TIMESTEP_S), integrator="implicitfast")
        world = ET.SubElement(root, "worldbody")
        add_robot(root, world, hand_alone(), pose(R), visuals=False)
        connector = next(body for body in root.iter("body") if body.get("name") == "reflex/base_link")
        connector.attrib.update(pos="0 0 0", quat="1 0 0 0")
        prepare_hand(root)
        if thing is not None:
            T = pose(R) @ T_hand_thing
            add_object(world, "thing", thing)
            body = world.find("body[@name='object/thing']")
            body.attrib.update(pos=numbers(T[:3, 3]), quat=quaternion(T[:3, :3]))
            ET.SubElement(ET.SubElement(root, "equality"), "weld", body1="object/thing")
        self.add(world)
        self.model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
        self.data = mujoco.MjData(self.model)
        self.mechanics = PhysicalMechanics()
        self.mechanics.bind(self.model, self.data)
        self.hand = SimulatedHand(seed, self.mechanics)
        self.hand.handle(ModeCommand((POSITION,) * 4))

    def add(self, world):
        """Adds something to the world."""

    @property
    def thing(self):
        return self.data.joint("object/thing")

    def let_go(self):
        """Leaves the thing to the hand and gravity."""
        self.data.eq_active[:] = 0

    def close(self, *spools):
        """Sends the servos to spool angles [rad]."""
        state = self.hand.state()
        there = np.array(state["positions"]) + CLOSING * TICKS_PER_RAD * (np.array(spools) - state["angles"])
        self.hand.handle(TargetCommand(tuple(round(tick) for tick in there)))

    def run(self, seconds, each=lambda: None):
        for _ in range(round(seconds / TIMESTEP_S)):
            mujoco.mj_step1(self.model, self.data)
            self.hand.step(TIMESTEP_S)
            mujoco.mj_step2(self.model, self.data)
            each()

    def counts(self):
        return np.array(self.hand.state()["touch"])


def test_a_free_finger_shares_the_tendon_as_the_kinematic_one_does_and_is_far_from_overload():
    bench = Bench(PALM_AHEAD)
    for spool in (0.5, 2.0, 3.5):
        bench.close(spool, spool, spool, 0.0)
        bench.run(2.0)
        state = bench.hand.state()
        proximal, distal = np.array(state["proximal"]), np.array(state["distal"])
        np.testing.assert_allclose(proximal + distal, spool, atol=0.06)
        np.testing.assert_allclose(distal, FLEXURE_RATIO * proximal, atol=0.12)
        assert max(state["efforts"][i] * CLOSING[i] for i in range(3)) < 250
        assert not bench.counts()[:, :8].any()


@pytest.mark.parametrize("R", [np.eye(3), PALM_DOWN, PALM_AHEAD, FINGERS_UP], ids=["up", "down", "ahead", "sideways"])
def test_springs_keep_the_fingers_open_in_every_orientation(R):
    bench = Bench(R)
    bench.close(-1.0, -1.0, -1.0, 0.0)
    bench.run(1.5)
    state = bench.hand.state()
    np.testing.assert_allclose(state["proximal"] + state["distal"], 0.0, atol=0.03)
    assert [bench.mechanics.resistance(i) for i in range(3)] == [0.0] * 3, "a slack tendon pulls nothing"


def test_both_swivels_follow_the_one_motor():
    bench = Bench()
    bench.close(0.0, 0.0, 0.0, 1.0)
    bench.run(2.0)
    angles = [bench.data.joint(f"reflex/preshape_{i}").qpos[0] for i in (1, 2)]
    np.testing.assert_allclose(angles, [1.0, -1.0], atol=0.02)


def test_a_blocked_finger_bends_outside_with_load_and_is_free_again():
    bench = Bench()
    bench.hand.block(0, 0.4, stiffness=0.0)
    bench.close(1.2, 1.2, 1.2, 0.0)
    bench.run(2.0)
    state = bench.hand.state()
    assert state["proximal"][0] == pytest.approx(0.4, abs=0.03)
    assert state["distal"][0] > 2.0 * state["distal"][1]
    assert state["efforts"][0] > 1.5 * -state["efforts"][1] > 0
    bench.hand.block(0, None)
    bench.run(0.5)
    assert bench.hand.state()["proximal"][0] == pytest.approx(bench.hand.state()["proximal"][2], abs=0.05)


def test_an_obstacle_stays_when_the_model_is_built_anew():
    bench = Bench()
    bench.hand.block(1, 0.4)
    model = mujoco.MjModel.from_xml_string(mujoco_text(bench.model))
    bench.mechanics.bind(model, mujoco.MjData(model))
    assert model.joint("reflex/proximal_joint_2").range[1] == 0.4


def mujoco_text(model):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        mujoco.mj_saveLastXML(str(path), model)
        return path.read_text()


def test_a_stalled_servo_pulls_with_its_largest_torque_then_switches_off_until_power_comes_anew():
    bench = Bench()
    bench.hand.block(0, 0.2, stiffness=0.0)
    bench.close(3.6, 0.0, 0.0, 0.0)
    bench.run(2.5)
    efforts = []
    bench.run(0.5, lambda: efforts.append(bench.hand.state()["efforts"][0]))
    assert 950 <= max(efforts) <= 1000
    bench.run(2.5)
    state = bench.hand.state()
    assert state["torque"] == [False, True, True, True] and bench.hand.packet()[166] == OVERLOAD_BIT
    bench.hand.handle(ModeCommand((POSITION,) * 4))
    assert not bench.hand.state()["torque"][0]
    bench.hand.power_cycle()
    bench.hand.handle(ModeCommand((POSITION,) * 4))
    assert bench.hand.state()["torque"][0] and bench.hand.packet()[166] == 0


class Weighing(Bench):
    """A weight of 100 g with a round foot stands on taxel 2 of the index finger, which lies flat."""

    def add(self, world):
        body = ET.SubElement(world, "body", name="weight", pos="0.0951 -0.026 0.107")
        ET.SubElement(body, "joint", type="slide", axis="0 0 1", damping="1")
        ET.SubElement(body, "geom", type="sphere", size="0.01", mass="0.1", contype="2", conaffinity="3")


def test_a_taxel_counts_the_weight_that_stands_on_it_and_its_neighbours_less():
    bench = Weighing()
    bench.run(1.0)
    index, *others = bench.counts()
    assert index[2] == pytest.approx(0.1 * 9.81 * COUNTS_PER_N, rel=0.05)
    assert index[1] == pytest.approx(index[3], rel=0.1) and 0.1 * index[2] < index[1] < 0.5 * index[2]
    np.testing.assert_array_equal(index[4:], np.clip(index[4:], 0.0, 1.0))
    assert not np.any(others)


def test_pressed_taxels_count_besides_what_touches():
    bench = Weighing()
    bench.run(1.0)
    at = 8 + 2 * 2
    before = int.from_bytes(bench.hand.packet()[at : at + 2], "little")
    bench.hand.press(0, 50, cell=2)
    assert int.from_bytes(bench.hand.packet()[at : at + 2], "little") - before == pytest.approx(50, abs=2)


@pytest.mark.parametrize("grasp", GRASPS)
def test_holds_a_cup_without_creep_or_jitter_and_releases_it(grasp):
    """It creeps by at most 1 mm and 0.5 degrees in ten seconds."""
    R, T = GRASPS[grasp]
    bench = Bench(R, THINGS["cup"], T)
    bench.run(0.2)
    assert not bench.counts().any()
    bench.close(*GRIP)
    bench.run(2.0)
    bench.let_go()
    bench.run(0.5)
    start, speeds = bench.thing.qpos.copy(), []
    bench.run(2.0, lambda: speeds.append(np.linalg.norm(bench.thing.qvel[:3])))
    assert np.linalg.norm(bench.thing.qpos[:3] - start[:3]) < 0.0002
    assert abs(bench.thing.qpos[3:] @ start[3:]) > math.cos(math.radians(0.1) / 2.0)
    assert np.sqrt(np.mean(np.square(speeds))) < 0.001
    assert all(finger.max() > 10 for finger in bench.counts())
    assert max(abs(effort) for effort in bench.hand.state()["efforts"]) < 350
    bench.close(0.0, 0.0, 0.0, 0.0)
    bench.run(1.5)
    assert start[2] - bench.thing.qpos[2] > 0.5
    assert not bench.counts().any()


@pytest.mark.parametrize("name, more", [("box", 0.0), ("ball", 0.3), ("cylinder", 0.0), ("bottle", 0.0)])
def test_holds_every_kind_of_thing(name, more):
    """The two fingers meet a ball beside its middle, where it is narrower."""
    bench = Bench(PALM_AHEAD, THINGS[name], LYING)
    bench.close(*(spool + more for spool in GRIP[:3]), 0.0)
    bench.run(2.0)
    bench.let_go()
    bench.run(0.5)
    start = bench.thing.qpos.copy()
    bench.run(2.0)
    assert np.linalg.norm(bench.thing.qpos[:3] - start[:3]) < 0.001


def gripped(force_limit):
    """Returns counts and efforts of a cup gripped by a driver that would close the fingers to 2.7 rad."""
    bench = Bench(PALM_AHEAD, THINGS["cup"], LYING)
    limit = ForceLimit(SimpleNamespace(**LIMITS, force_limit=force_limit))
    for step in range(160):
        state = bench.hand.state()
        loads = tuple(CLOSING[i] * state["efforts"][i] for i in range(3))
        felt = FingerFeedback(tuple(state["angles"][:3]), tuple(map(tuple, bench.counts())), loads)
        limit.update(felt, PERIOD_S * step)
        bench.close(*limit.clip((2.7, 2.7, 2.5, 0.0), PERIOD_S * step).command)
        bench.run(PERIOD_S)
        if step == 100:
            bench.let_go()
            start = bench.thing.qpos[:3].copy()
    assert np.linalg.norm(bench.thing.qpos[:3] - start) < 0.005
    return bench.counts().max(), max(abs(effort) for effort in bench.hand.state()["efforts"])


def test_the_force_limit_of_leap_hand_grips_gently_and_still_holds():
    (gentle, low), (hard, high) = gripped(True), gripped(False)
    assert gentle < 1.5 * LIMITS["force_limit_pressure"] < hard
    assert low < LIMITS["force_limit_load"] < high


def test_the_wire_carries_what_the_physics_does():
    bench = Bench(PALM_AHEAD, THINGS["cup"], LYING)
    rest = np.frombuffer(bench.hand.packet()[8:62], "<u2").astype(float).reshape(3, 9)
    encoders = np.frombuffer(bench.hand.packet()[160:166], "<u2").astype(float)
    bench.close(*GRIP)
    bench.run(round(2.0 / PERIOD_S) * PERIOD_S)
    packet = bench.hand.packet()
    pressed = np.frombuffer(packet[8:62], "<u2").astype(float).reshape(3, 9) - rest
    np.testing.assert_allclose(pressed, np.minimum(bench.counts()[[0, 2, 1]], 310 - rest), atol=2.5)
    turned = np.mod(encoders - np.frombuffer(packet[160:166], "<u2"), 16384) * 2 * math.pi / 16384
    np.testing.assert_allclose(turned, bench.hand.state()["proximal"], atol=0.002)
    loads = np.frombuffer(packet[186:194], "<u2").astype(int) % 1024
    assert all(50 < load < 350 for load in loads[:3])

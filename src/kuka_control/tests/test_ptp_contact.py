"""PTP motions that end at a contact: the torques that are expected on the way, and what follows from others."""

from __future__ import annotations

from dataclasses import replace

import link_world
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_world import World, rig, shifted

from common import clock
from common.mounting import rotation_of_mounting
from kuka_control.loop.commands import End, StartPtp, Wait
from kuka_control.loop.transitions import State
from kuka_control.model.config import PtpConfig, RealTimeConfig
from kuka_control.model.ptp_contact import torque_ranges, touched
from kuka_control.model.switches import ExitInPlace
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.paths import JointMove
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.files import read_urdf

LOAD = rig(RealTimeConfig)[1].load
MOUNTINGS = ((0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 90.0, 0.0))
ARMS = [
    SimulatedArm(Robot(read_urdf("LBR7R800", "MF_elektrisch"), rpy), ArmSettings(tool_weight=True)) for rpy in MOUNTINGS
]
LOADS = [replace(LOAD, up=rotation_of_mounting(rpy)[2]) for rpy in MOUNTINGS]
PUSH = np.array([0.0, -31.0, 0.0, 0.0, 0.0, 0.0, 0.0])
joints = st.lists(st.floats(-1.6, 1.6), min_size=7, max_size=7).map(lambda q: np.round(q, 3))
both = pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])


def force_of(load, q, acceleration, payload):
    """The external torques of hand and payload as point masses that are accelerated [m/s^2], shape (2, 3)."""
    kinematics, torques = load.kinematics, load.torques(q, payload)
    for mass, T, a in zip((load.mass, payload), points_in_flange(load), acceleration):
        at_point = replace_tool(kinematics, T)
        torques = torques - at_point.jacobian(q)[:3].T @ (mass * a)
    return torques


def points_in_flange(load):
    center = np.eye(4)
    center[:3, 3] = load.center_of_mass
    return center, load.kinematics.T_flange_tool


def replace_tool(kinematics, T):
    return type(kinematics)(kinematics.model, T)


@given(joints, joints, st.floats(0.01, 1.0), st.floats(0.0, 2.0), st.sampled_from(range(3)), st.floats(0.0, 1.0))
@settings(max_examples=60)
def test_weight_and_inertia_of_hand_and_load_end_no_motion(start, goal, velocity, payload, k, when):
    """By the simulated controller's motion, differentiated twice, and Pinocchio's weight of the hand."""
    arm, load = ARMS[k], LOADS[k]
    if np.max(np.abs(goal - start)) < 1e-3:
        return
    low, high = torque_ranges(load, start, goal, velocity, payload, 0.05).T
    motion = JointMove(start, goal, velocity * arm.robot.max_speed, arm.motion_acceleration)
    dt = 2e-3
    t = min(max(when * motion.duration, dt), motion.duration - dt)
    places = []
    for T in points_in_flange(load):
        tool = replace_tool(load.kinematics, T)
        before, now, after = (tool.forward(motion.at(t + x * dt))[:3, 3] for x in (-1, 0, 1))
        places.append((before - 2.0 * now + after) / dt**2)
    torques = force_of(load, motion.at(t), places, payload)
    assert np.all((torques >= low) & (torques <= high)), (torques, low, high)
    arm.q = motion.at(t)
    if payload == 0.0:
        assert np.all((arm.external_torques >= low) & (arm.external_torques <= high))
    assert np.all((low < 0.0) & (high > 0.0)), "a cabinet that knows of hand and load sees nothing of them"


@given(joints, joints, st.floats(0.01, 1.0), st.floats(1.0, 30.0))
def test_the_margin_is_on_both_sides_and_all_that_an_arm_without_a_hand_has(start, goal, velocity, margin):
    bare = replace(LOAD, mass=0.0)
    np.testing.assert_array_equal(torque_ranges(bare, start, goal, velocity, 0.0, margin), 7 * [[-margin, margin]])
    none, some = (torque_ranges(LOAD, start, goal, velocity, 0.3, m) for m in (0.0, margin))
    np.testing.assert_allclose(some - none, 7 * [[-margin, margin]])


def test_on_the_way_home_the_ranges_are_narrow():
    """So that the hand pushes with less than 40 N at 0.55 m from joint 1, where its weight makes no torque."""
    home = rig(RealTimeConfig)[1].home.q
    ranges = torque_ranges(LOAD, home + np.array([0.5, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0]), home, 0.25, 0.0, 10.0)
    assert ranges[0, 1] < 22.0 and np.all(np.abs(ranges) < 25.0), ranges


def test_what_was_touched_is_said():
    ranges = np.tile((-10.0, 12.0), (7, 1))
    assert touched(PUSH, ranges) == "joint 2 bears -31.0 Nm from outside, out of -10.0 to 12.0 Nm"
    assert touched(0.2 * PUSH, ranges) == "joint 2 bears -6.2 Nm from outside, now again within -10.0 to 12.0 Nm"
    assert "could not be read" in touched(None, ranges)


def test_every_ptp_motion_of_the_controllers_ends_at_a_contact():
    world = World()
    world.at_home()
    world.control_on = True
    world.until("pick_up", 4.0, shifted(0.0, 0.1, -0.1)).run(1.0, shifted(0.0, 0.1, -0.1))
    world.control_on = False
    world.until("home", 9.0)
    world.control_on = True
    world.ask("aside").until("holding", 9.0)
    world.exit_requested = True
    world.run(9.0)
    q, starts = np.full(7, 0.1), [step.command for step in world.steps if isinstance(step.command, StartPtp)]
    assert len(starts) == 5
    for command in starts:
        assert command.torques.shape == (7, 2)
    np.testing.assert_allclose(
        starts[0].torques, torque_ranges(world.rig.load, q, starts[0].q, starts[0].velocity, 0.0, 10.0)
    )


def test_with_0_nothing_is_asked_for():
    world = World(ptp_contact_torque=0.0)
    world.run(0.1)
    assert world.arm.mode == "ptp" and world.arm.ranges is None


@pytest.mark.hazard(4)
@both
@pytest.mark.parametrize("torques", [PUSH, None])
def test_a_contact_is_latched_with_joint_and_torque_and_no_motion_follows(schema, torques):
    world = World(schema)
    world.run(0.3)
    world.arm.touches = (torques,)
    world.run(0.1)
    assert world.mode == "stopped" and "The arm touched something on its way to home" in world.loop.stopped_because
    assert torques is None or "joint 2 bears -31.0 Nm" in world.loop.stopped_because
    at, before = world.arm.q, len(world.steps)
    world.control_on = True
    world.control_on = False
    world.run(12.0, shifted(0.0, 0.05, 0.0))
    assert all(isinstance(step.command, Wait) for step in world.steps[before:])
    np.testing.assert_array_equal(world.arm.q, at)
    assert world.loop.exit_in_place is ExitInPlace.TOUCHED
    world.control_on = True
    world.until("home", 9.0)
    assert world.loop.stopped_because is None and world.loop.exit_in_place is None


@both
@pytest.mark.parametrize("first", [True, False])
def test_an_exit_leaves_an_arm_that_touched_something(schema, first):
    """Whether it was asked for before the contact or after it."""
    world = World(schema)
    world.run(0.3)
    world.exit_requested = first
    world.arm.touches = (PUSH,)
    world.run(0.1)
    world.exit_requested = True
    world.run(1.0)
    assert isinstance(world.steps[-1].command, End) and "it touched something" in world.steps[-1].command.fault
    assert [name for name, *_ in world.arm.commands] == ["ptp"]


def test_on_the_way_to_zero_a_contact_ends_the_controller_where_the_arm_stands():
    world = World().at_home()
    world.exit_requested = True
    world.run(0.3)
    world.arm.touches = (PUSH,)
    world.run(1.0)
    assert world.state is State.ENDED and "joint 2 bears -31.0 Nm" in world.steps[-1].command.fault


@pytest.mark.parametrize("fault", ["torn", "slow", "bursts", "unfinished"])
def test_an_answer_that_is_torn_late_or_lost_moves_nothing_on_and_is_said(fault):
    """A contact whose word does not come is not known as one, but the arm is seen to stand."""
    with link_world.bench() as bench:
        bench.run(clock.monotonic() + 1.0)
        bench.server.faults.switch(fault, True)
        bench.robot.set_external_torque(np.array([16.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        bench.run(clock.monotonic() + 3.0)
        at, lost = bench.robot.q, fault == "unfinished"
        assert not bench.robot.v.any() and bench.robot.safety_stop is None
        assert bench.mode == ("homing" if lost else "stopped")
        said = "The motion to home does not continue" if lost else "joint 1 bears 16.0 Nm"
        assert said in bench.loop.stopped_because
        bench.robot.set_external_torque(np.zeros(7))
        bench.enable_count += 0 if lost else 1
        bench.run(clock.monotonic() + 2.0)
        assert lost == np.array_equal(bench.robot.q, at), "only the operator lets it go on"


@pytest.mark.parametrize("tool_weight", [False, True])
def test_a_cabinet_that_takes_the_hand_for_external_and_one_that_knows_it_bring_the_arm_home(tool_weight):
    with link_world.bench(tool_weight=tool_weight) as bench:
        bench.run(clock.monotonic() + 20.0, "home")
        assert "doPTP!inJS" in bench.sent and np.any(bench.robot.external_torques) == tool_weight


def test_the_whole_way_from_a_push_at_the_simulated_arm_to_the_latch():
    with link_world.bench() as bench:
        bench.run(clock.monotonic() + 1.0)
        assert "doPTP!inJS" in bench.sent and bench.mode == "homing"
        bench.robot.set_external_torque(np.array([14.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        bench.run(clock.monotonic() + 5.0, "stopped")
        assert "joint 1 bears 14.9 Nm from outside" in bench.loop.stopped_because
        assert not bench.robot.v.any() and bench.robot.safety_stop is None
        bench.robot.set_external_torque(np.zeros(7))
        at = bench.robot.q
        bench.run(clock.monotonic() + 3.0)
        np.testing.assert_array_equal(bench.robot.q, at)
        bench.enable_count += 1  # control off and on
        bench.run(clock.monotonic() + 20.0, "home")

"""Joints that are measured wrongly move no arm, whenever that begins, although goals are made from them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_world import DT, HOME, SLOW, FakeArm, World, ptp, shifted

from kuka_control.loop.commands import End
from kuka_control.loop.servo_law import lts
from kuka_control.loop.tracking import BELIEVED_RAD, JointCheck
from kuka_control.model.config import PtpConfig, RealTimeConfig
from kuka_control.model.switches import Switches

DRIVES_S = 0.04
FULL_SPEED = np.radians([98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0])
FAULTS = [0.02, 0.1, 0.5, -0.1]
STAYS_RAD = 0.03
offsets = pytest.mark.parametrize("offset", FAULTS)
laws = pytest.mark.parametrize("law", ["none", "lts"])


class ServoArm(FakeArm):
    """Follows its goals in servo mode as the robot's loop does, by its law, in steps of 1 ms."""

    def __init__(self, law):
        super().__init__()
        self.law = lts if law == "lts" else lambda error: error

    def tick(self, dt):
        if self.mode != "servo":
            return super().tick(dt)
        for _ in range(round(dt / 1e-3)):
            self.q = self.q + 1e-3 / DRIVES_S * self.law(self.goal - self.q)


def at_home(schema=RealTimeConfig, law="none"):
    world = World(schema, ServoArm(law)).until("home", 9.0)
    world.arm.commands.clear()
    return world


def following(law):
    world = at_home(law=law)
    world.control_on = True
    world.until("servo", 4.0, shifted(0.0, 0.0, 0.0)).run(76 * DT, shifted(0.0, 0.0, 0.0))
    world.arm.commands.clear()
    return world


def circle(t):
    return shifted(0.05 * np.sin(2.0 * t), 0.0, 0.05 * (1.0 - np.cos(2.0 * t)))


def watch(world, seconds, tool=None):
    """Runs cycle by cycle; returns the true joints after each, shape (n, 7) [rad]."""
    start, found = world.now, [world.arm.q]
    for _ in range(round(seconds / DT)):
        world.run(DT, tool(world.now - start) if callable(tool) else tool)
        found.append(world.arm.q)
    return np.array(found)


def enable_again(world):
    world.control_on = False
    world.run(0.3)
    world.control_on = True


def is_latched(world):
    return world.mode == "stopped" and "not believed" in world.loop.stopped_because


@offsets
@laws
def test_an_arm_that_stands_in_servo_mode_stays(law, offset):
    world = following(law)
    world.arm.shift = offset
    joints = watch(world, 1.5, shifted(0.0, 0.0, 0.0))
    assert np.max(np.abs(joints - joints[0])) < 2e-3
    assert is_latched(world) and world.arm.commands == [("stop_servo",)]
    assert re.search(r"joint \d is at -?\d+\.\d\d deg", world.loop.stopped_because)


def test_joints_are_compared_with_where_the_arm_is_to_come_not_with_goals_beyond_it(monkeypatch):
    world = following("lts")
    monkeypatch.setattr(world.loop._joints, "follow", lambda q, _: compared.append(q))
    for braking in (False, True):
        compared: list = []
        world.arm.goals.clear()
        world.control_on = not braking
        beyond = 0.0
        for i in range(20 if braking else 250):
            world.run(DT, None if braking else circle(i * DT))
            if compared and world.arm.mode == "servo":
                np.testing.assert_array_equal(compared[-1], world.loop.goal)
                beyond = max(beyond, float(np.max(np.abs(world.arm.goals[-1] - compared[-1]))))
        assert beyond > 0.005


@offsets
@laws
def test_an_arm_that_moves_stops_without_a_jump(law, offset):
    world = following(law)
    before = watch(world, 1.0, circle)
    world.arm.shift = offset
    joints = watch(world, 1.5, lambda t: circle(t + 1.0))
    steps = np.max(np.abs(np.diff(joints, axis=0)), axis=1)
    assert np.max(steps) < np.max(np.abs(np.diff(before, axis=0))) + 0.3 * DT
    if abs(offset) > 0.05:
        assert is_latched(world) and np.max(np.abs(joints - joints[0])) < STAYS_RAD


@pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
@offsets
def test_joints_that_become_wrong_at_home_start_nothing_until_they_are_right_again(schema, offset):
    world = at_home(schema)
    world.arm.shift = offset
    world.run(2.0 * DT)
    world.control_on = True
    watch(world, 2.0, shifted(0.1, 0.0, 0.0))
    assert is_latched(world) and not world.arm.commands
    assert sum("once they are right again" in event for event in world.events) == 1
    world.arm.shift = 0.0
    world.run(1.0, shifted(0.1, 0.0, 0.0))
    assert is_latched(world) and not world.arm.commands, "only the operator opens the latch"
    enable_again(world)
    world.run(DT)
    assert world.arm.commands == [ptp(HOME.q, SLOW)]


@pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
def test_exit_with_joints_in_doubt_leaves_the_arm_where_it_stands(schema):
    world = at_home(schema)
    world.arm.shift = 0.1
    world.run(2.0 * DT)
    world.exit_requested = True
    world.run(1.0)
    assert not world.arm.commands
    assert isinstance(world.steps[-1].command, End) and "not believed" in world.steps[-1].command.fault


def test_what_the_services_answer_in_doubt_holds_though_the_joints_become_right_at_that_moment():
    world, switches = at_home(), Switches()
    world.arm.shift = 0.1
    world.run(2.0 * DT)
    switches.report(world.mode, world.loop.stopped_because, world.loop.when_enabled, world.loop.exit_in_place)
    answer = switches.set_control(True)
    assert not answer.success and "not believed" in answer.message and switches.now.enable_count == 0
    assert "leaves the arm where it is" in switches.request_exit().message
    world.arm.shift = 0.0
    world.exit_requested, world.exit_in_place = True, switches.now.exit_in_place
    world.run(1.0)
    assert isinstance(world.steps[-1].command, End) and not world.arm.commands


@offsets
@laws
def test_joints_that_were_wrong_from_the_beginning_start_nothing_but_the_way_home(law, offset):
    world = World(arm=ServoArm(law))
    world.arm.shift = offset
    world.control_on = True
    world.run(4.0, shifted(0.1, 0.0, 0.0))
    assert is_latched(world) and [t[0] for t in world.arm.commands] == ["ptp"]
    enable_again(world)
    world.run(4.0).run(2.0, shifted(0.1, 0.0, 0.0))
    assert is_latched(world) and [t[0] for t in world.arm.commands] == ["ptp"]
    world.arm.shift = 0.0
    world.run(DT)
    enable_again(world)
    world.run(6.0).run(4.0, shifted(0.1, 0.0, 0.0))
    assert world.mode == "servo"


@laws
def test_joints_that_become_wrong_when_servo_mode_starts_get_no_goal(law):
    world = at_home(law=law)
    start_servo = world.arm.start_servo

    def starts_wrong():
        world.arm.shift = 0.1
        start_servo()

    world.arm.start_servo = starts_wrong
    world.control_on = True
    watch(world, 1.0, shifted(0.003, 0.0, 0.0))
    assert is_latched(world) and world.arm.commands == [("start_servo",), ("stop_servo",)]
    np.testing.assert_allclose(world.arm.q, HOME.q, atol=2e-3)


def check(goals, readings, age=2.0 * DT):
    """Returns what the check says of the last of the readings; a goal is sent after each."""
    joints, wrong = JointCheck(FULL_SPEED), None
    joints.stand(readings[0])
    for k, measured in enumerate(readings):
        wrong = joints.step(measured, k * DT, age)
        if k < len(goals):
            joints.follow(goals[k], k * DT)
    return wrong


@settings(max_examples=25)
@given(st.floats(-1.5, 1.5), st.floats(0.03, 0.15), st.integers(1, 10), st.sampled_from([1, 2, 5]))
def test_an_arm_that_follows_is_believed_also_when_readings_are_old_and_rare(speed, lag, delay, every):
    q, goal, joints = np.zeros(7), np.zeros(7), JointCheck(FULL_SPEED)
    joints.stand(q)
    past = [q] * (delay + 1)
    for k in range(300):
        if k % every == 0:
            assert joints.step(past[-1 - delay].copy(), k * DT, (every + delay + 1) * DT) is None
        goal = goal + speed * DT * (1.0 if k < 150 else -1.0)
        joints.follow(goal, k * DT)
        q = q + (goal - q) * min(DT / lag, 1.0)
        past.append(q)


def test_where_the_arm_is_not_known_everything_is_believed():
    joints = JointCheck(FULL_SPEED)
    assert joints.step(np.zeros(7), 0.0, np.inf) is None
    assert joints.step(np.ones(7), 0.1, 0.1) is None
    joints.stand(np.ones(7))
    assert joints.step(np.ones(7) + 0.9 * BELIEVED_RAD, 0.2, 0.1) is None
    assert joints.step(np.ones(7) + 2.5 * BELIEVED_RAD, 0.3, 0.1) is not None


@pytest.mark.parametrize("offset", [1.1 * BELIEVED_RAD, -1.1 * BELIEVED_RAD])
@pytest.mark.parametrize("joint", range(7))
def test_the_joint_is_named_with_its_angles(joint, offset):
    still = np.radians(np.arange(7.0))
    wrong = still.copy()
    wrong[joint] += offset
    said = check([still], [still, wrong], age=0.004)
    assert f"joint {joint + 1} is at {np.degrees(wrong[joint]):.2f} deg" in said
    assert f"{joint:.2f} deg" in said

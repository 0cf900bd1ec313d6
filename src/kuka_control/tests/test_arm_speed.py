"""The speed limit holds for the whole moving arm, of each kind, in every kind of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_world import DT, World, rig, shifted
from point_speeds import point_speeds

from common.poses import pose, translation
from common.rotations import rotation_from_zyx
from iiwa_kinematics import full_speed_time
from kuka_control.limits.line_plan import MoveRefused, plan_line
from kuka_control.loop import assembly
from kuka_control.model.config import PtpConfig, RealTimeConfig
from kuka_control.model.obstacles import ConvexBody, ConvexShape
from kuka_control.model.robot_shape import Opening

FLAT, UP, FOLDED = (Opening((angle,) * 3, (0.0,) * 3, 0.0) for angle in (0.0, 0.5 * np.pi, np.pi))
BOX = ConvexBody("held", 7, ConvexShape("box", (0.1, 0.1, 0.3)), translation(0.0, 0.0, 0.4))
seeds = st.integers(0, 2**32 - 1)
arms = pytest.mark.parametrize(
    "changes",
    [{}, {"robot": "LBR14R820"}, {"mounting": (0.0, 90.0, 0.0), "elbow_preference": 60.0, "tcp_speed": 0.2}],
    ids=["shipped", "the larger arm", "an arm on the wall, slow"],
)


def arm(schema=RealTimeConfig, held=False, **changes):
    config, found = rig(schema, **changes)
    return config, replace(found, obstacles=(BOX,)) if held else found


def test_the_flange_carries_the_tool_the_finger_tips_and_what_is_held():
    _, found = arm(held=True)
    tool, *tips, box = found.carried(UP)
    assert tool == (0.0, 0.0, 0.106, 0.0)
    np.testing.assert_allclose([tip[2] for tip in tips], 0.1076 + 0.066 + 0.038, atol=5e-3)  # knuckle, two phalanges
    np.testing.assert_allclose(box, (0.0, 0.0, 0.4 - found.model.wrist_flange, np.hypot(0.15, 0.05 * 2**0.5)))
    for opening in (FLAT, UP, FOLDED):
        for (*tip, radius), (*knuckle, reach) in zip(found.carried(opening)[1:4], found.carried(None)[1:4]):
            assert 0.1 < np.linalg.norm(np.subtract(tip, knuckle)) + radius <= reach + 1e-3


@pytest.mark.hazard(3)
@arms
@settings(max_examples=20)
@given(seed=seeds)
def test_no_point_is_faster_in_the_stream_whatever_the_fingers_do(changes, seed):
    rng = np.random.default_rng(seed)
    config, found = arm(held=rng.random() < 0.3, **changes)
    limits, lower, upper = assembly.motion_limits(config, found), 0.9 * found.model.lower, 0.9 * found.model.upper
    limits.reset(np.clip(found.home.q, lower, upper))
    for _ in range(3):
        carried = found.carried([None, FLAT, UP, FOLDED][rng.integers(4)])
        for _ in range(100):  # the hand opens or closes while the arm rests
            limits.brake(DT)
        limits.carry(carried)
        goals, target = [limits.goal], np.clip(limits.goal + rng.uniform(-1.0, 1.0, 7), lower, upper)
        goals += [limits.step(target, limits.goal, DT).q for _ in range(150)]
        speeds = point_speeds(found.model, DT * np.arange(len(goals)), goals, carried)
        assert np.max(speeds) <= config.tcp_speed


def test_the_present_opening_of_the_hand_counts():
    """Joint 7 turns the hand on the spot: only its fingers move."""
    fastest = {}
    for opening in (None, FLAT, UP, FOLDED):
        world = World(tcp_speed=0.2).following()
        world.loop.open_hand(opening)
        limits, goals = world.loop._limits, [world.loop.goal]
        target = goals[0] + np.eye(7)[6]
        goals += [limits.step(target, limits.goal, DT).q for _ in range(200)]
        speeds = point_speeds(world.rig.model, DT * np.arange(len(goals)), goals, world.rig.carried(opening))
        assert 0.18 < np.max(speeds) <= 0.2
        fastest[opening] = np.max(np.diff(goals, axis=0)) / DT
    assert fastest[None] <= fastest[FLAT] < fastest[UP]


@settings(max_examples=25)
@given(seed=seeds)
def test_no_point_is_faster_on_a_line(seed):
    rng = np.random.default_rng(seed)
    config, found = arm(tcp_speed=float(rng.choice([0.2, 0.65])), held=rng.random() < 0.3)
    limits = assembly.line_limits(config, found)
    T = shifted(*rng.uniform(-0.05, 0.05, 3))
    T = pose(T[:3, :3] @ rotation_from_zyx(*rng.uniform(-0.6, 0.6, 3)), T[:3, 3])
    try:
        plan = plan_line(limits, found.home.q, T, limits.speed)
    except MoveRefused:
        return
    times = np.linspace(0.0, plan.duration, 400)
    speeds = point_speeds(found.model, times, [plan.at(t)[0] for t in times], found.carried(None))
    assert np.max(speeds) <= 1.002 * limits.speed < config.tcp_speed


@pytest.mark.hazard(4)
@pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
@settings(max_examples=40)
@given(seed=seeds)
def test_no_point_is_faster_in_a_ptp_motion_whatever_the_fingers_do(schema, seed):
    rng = np.random.default_rng(seed)
    changes = {"tcp_speed": float(rng.choice([0.2, 0.65]))} if schema is RealTimeConfig else {}
    config, found = arm(schema, rng.random() < 0.3, **changes)
    start, goal = rng.uniform(found.model.lower, found.model.upper, (2, 7))
    velocity = found.ptp_velocity(start, goal, rng.choice([0.15, 0.25, 0.99]))
    times = np.linspace(0.0, full_speed_time(found.model, start, goal) / velocity, 200)
    joints = start + np.linspace(0.0, 1.0, 200)[:, None] * (goal - start)
    for opening in (None, FLAT, UP, FOLDED):
        assert np.max(point_speeds(found.model, times, joints, found.carried(opening))) <= found.ptp_speed
    assert found.ptp_speed == changes.get("tcp_speed", 0.75)

"""The stream that is sent keeps all limits by the real times of its goals, whatever targets, cycles and stops come.

The speed limit holds for every point of the moving arm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loop_world import rig
from point_speeds import point_speeds

from kuka_control.limits.motion_limits import MotionLimits
from kuka_control.limits.moving_arm import ShapeLimits
from kuka_control.loop import assembly
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.robot_shape import Opening
from kuka_control.numbers import GAP_S

CONFIG, RIG = rig(RealTimeConfig)
PACE = RIG.model.max_speed / np.min(RIG.model.max_speed)
SPEED = CONFIG.joint_speed * RIG.model.max_speed
ACCELERATION, JERK = CONFIG.joint_acceleration * PACE, CONFIG.joint_jerk * PACE
LOWER = RIG.model.lower + assembly.RANGE_MARGIN_RAD
UPPER = RIG.model.upper - assembly.RANGE_MARGIN_RAD
OUTSIDE_M = 2e-3  # how far the tool of a goal may be outside the workspace [m]


def stream_limits(in_workspace):
    limits = assembly.motion_limits(CONFIG, RIG)
    if in_workspace:
        return limits
    room = replace(limits._room, workspace=None)
    return MotionLimits(SPEED, ShapeLimits(ACCELERATION, JERK), room)


def tool(q):
    return RIG.kinematics.forward(q)[:3, 3]


def random_opening(rng):
    """Of the hand; None: not known."""
    opening = Opening(tuple(rng.uniform(0.0, 3.1, 3)), tuple(rng.uniform(0.0, 1.0, 3)), float(rng.uniform(0.0, 1.7)))
    return None if rng.random() < 0.3 else opening


def random_target(rng, in_workspace):
    if in_workspace:
        return RIG.home.q + rng.uniform(-0.6, 0.6, 7)
    at_limits = np.where(rng.random(7) < 0.5, LOWER, UPPER)
    return np.where(rng.random(7) < rng.choice([0.0, 0.5]), at_limits, rng.uniform(LOWER, UPPER))


def streams(rng, in_workspace, carried):
    """Runs random targets, cycles, gaps, caps and stops; returns (times, goals) of each run without a gap."""
    limits = stream_limits(in_workspace)
    limits.carry(carried)
    limits.reset(RIG.home.q if in_workspace else rng.uniform(LOWER, UPPER))
    t, parts, gap = 0.0, [([0.0], [limits.goal])], False
    for _ in range(rng.integers(1, 6)):
        target, cycle = random_target(rng, in_workspace), rng.choice([0.004, 0.004, 0.008, 0.02])
        speed = rng.uniform(-2.0, 2.0, 7) * (rng.random(7) < rng.choice([0.0, 0.3]))
        scale, cap, brakes = rng.choice([1.0, 1.0, 1.0 / 3.0]), rng.choice([1.0, 1.0, 0.5, 0.0]), rng.random() < 0.2
        for k in range(rng.integers(3, 120)):
            dt = cycle * rng.uniform(0.5, 1.4) if rng.random() < 0.5 else cycle
            dt = rng.uniform(GAP_S * 1.01, 0.3) if rng.random() < 0.005 else dt
            t += dt
            moving = np.clip(target + k * dt * speed, LOWER, UPPER)
            goal = limits.brake(dt) if brakes else limits.step(moving, limits.goal, dt, scale, speed, cap)
            gap, before_gap = dt > GAP_S, gap
            if gap:
                rest = parts[-1][1][-1]
                if before_gap:  # one gap follows the other: the goal moves on from rest
                    parts.append(([t - GAP_S - 0.004 * k for k in (2, 1, 0)] + [t], [rest] * 3 + [goal.q]))
                else:
                    assert np.array_equal(goal.q, rest) and not np.any(goal.v), "at rest where it was"
                    parts.append(([t - 0.008, t - 0.004, t], [goal.q] * 3))
            else:
                parts[-1][0].append(t)
                parts[-1][1].append(goal.q)
    return [(np.array(times), np.array(goals)) for times, goals in parts]


def derivatives(times, goals):
    """Speeds, accelerations and jerks as divided differences: means over the real times of two, three, four goals."""
    levels, level = [], goals
    for order in (1, 2, 3):
        if len(level) < 2:
            break
        level = order * np.diff(level, axis=0) / (times[order:] - times[:-order])[:, None]
        levels.append(level)
    return levels


def used(rng, in_workspace):
    """Returns the largest fractions of the limits of speed, acceleration, jerk and arm speed, and distances beyond."""
    worst = dict.fromkeys(("speed", "acceleration", "jerk", "arm speed"), 0.0)
    outside = beyond = 0.0
    carried = RIG.carried(random_opening(rng))
    for times, goals in streams(rng, in_workspace, carried):
        for (name, limit), level in zip(
            {"speed": SPEED, "acceleration": ACCELERATION, "jerk": JERK}.items(), derivatives(times, goals)
        ):
            worst[name] = max(worst[name], float(np.max(np.abs(level) / limit)))
        positions = np.array([tool(q) for q in goals])
        if len(times) > 1:
            fastest = float(np.max(point_speeds(RIG.model, times, goals, carried)))
            worst["arm speed"] = max(worst["arm speed"], fastest / CONFIG.tcp_speed)
        beyond = max(beyond, float(np.max(np.maximum(LOWER - goals, goals - UPPER))))
        if in_workspace:
            outside = max(outside, max(-min(RIG.workspace.rooms(p)) for p in positions))
    return worst, beyond, outside


@pytest.mark.hazard(3)
@pytest.mark.parametrize("in_workspace", [False, True], ids=["at joint limits", "at the workspace's bounds"])
@pytest.mark.parametrize("seed", range(8))
def test_the_sent_stream_keeps_every_limit(seed, in_workspace):
    rng = np.random.default_rng([seed, in_workspace])
    for _ in range(4):
        worst, beyond, outside = used(rng, in_workspace)
        assert worst["speed"] <= 1.0 + 1e-6 and worst["acceleration"] <= 1.0 + 1e-6, worst
        assert worst["jerk"] <= 1.01, worst  # a goal that rests within 1e-7 rad of its target is set to it
        assert worst["arm speed"] <= 1.0, worst
        assert beyond <= 1e-6 and outside <= OUTSIDE_M


def test_a_joint_brakes_before_its_limit_although_the_others_take_longer():
    """All joints change their speeds in step; one that nears its limit may not wait for the slowest."""
    limits = stream_limits(in_workspace=False)
    limits.reset(np.array([0.0, 0.5, 0.0, -1.2, 0.0, UPPER[5] - 0.12, 0.0]))
    speed = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.78, 1.0])
    goals = [limits.goal]
    for i in range(200):
        target = np.clip(goals[0] + (i + 1) * 0.004 * speed, LOWER, UPPER)
        turned = speed * np.array([1.0 if i < 20 else -1.0, 1, 1, 1, 1, 1, 1.0 if i < 20 else -1.0])
        goals.append(limits.step(target, limits.goal, 0.004, 1.0, turned).q)
    joint_6 = np.array(goals)[:, 5]
    assert joint_6[-1] == pytest.approx(UPPER[5], abs=1e-3) and np.max(joint_6) <= UPPER[5] + 1e-6
    assert np.max(np.abs(np.diff(joint_6, n=2))) / 0.004**2 <= 1.001 * ACCELERATION[5]


def test_a_stop_is_the_earliest_within_the_limits_and_ends_at_rest():
    limits = stream_limits(in_workspace=True)
    limits.reset(RIG.home.q)
    for _ in range(60):
        limits.step(RIG.home.q + 0.5, limits.goal, 0.004)
    speed = limits._now.v
    assert np.max(np.abs(speed)) > 0.2 and not limits.at_rest
    cycles = 0
    while not limits.at_rest:
        limits.brake(0.004)
        cycles += 1
    least = np.max(np.abs(speed) / ACCELERATION)
    assert least <= cycles * 0.004 <= 2.0 * least + 2.0 * np.max(ACCELERATION / JERK) + 0.008
    assert np.array_equal(limits.brake(0.004).q, limits.goal)


def test_the_guard_lets_a_start_beyond_a_limit_only_back():
    limits = stream_limits(in_workspace=False)
    start = np.array([0.0, 0.5, 0.0, -1.2, 0.0, UPPER[5] + 0.001, 0.0])
    limits.reset(start)
    outward = [limits.step(UPPER, limits.goal, 0.004).q[5] for _ in range(30)]
    assert max(outward) <= start[5] + 1e-9
    for _ in range(300):
        limits.step(start - 0.3, limits.goal, 0.004)
    assert limits.goal[5] == pytest.approx(start[5] - 0.3, abs=1e-3)

"""The whole stream, from tool frames to a moving arm: control loop and simulated controller in simulated time."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from bench.simulated import SimulatedRig
from rig_simulation.devices.sunrise.arm import ArmSettings
from rig_simulation.devices.sunrise.arm import SimulatedArm as Joints

DT = 0.004
STOP = 0.8
"""Speed of the tool at which the simulated controller stops the arm [m/s]."""


def rig(server_law="lts", **changes):
    return SimulatedRig(server_law, **changes).at_home()


def home(rig):
    return rig.rig.kinematics.forward(rig.rig.home.q)


def moved(T, shift, turn=None):
    result = T.copy()
    result[:3, 3] += shift
    if turn is not None:
        result[:3, :3] = result[:3, :3] @ turn
    return result


def about(axis, angle):
    """The rotation, shape (3, 3), about an axis of the tool; in the home pose y is across the plane of the arm."""
    x, y, z = np.eye(3)["xyz".index(axis)]
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def darting_hand(T, speed, seed):
    """A hand that darts between random points 15 cm about T at a peak speed [m/s], and sometimes pauses."""
    random = np.random.default_rng(seed)
    moves, at, time = [], np.zeros(3), 0.3
    for _ in range(60):
        to = random.uniform(-0.15, 0.15, 3)
        seconds = max(1.875 * np.linalg.norm(to - at) / speed, 0.12)
        moves.append((time, seconds, at, to))
        at, time = to, time + seconds + random.choice([0.0, 0.0, 0.1, 0.4])

    def tool(t):
        shift = np.zeros(3)
        for begin, seconds, a, b in moves:
            if t >= begin:
                s = min((t - begin) / seconds, 1.0)
                shift = a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        return moved(T, shift)

    return tool


def circle(T, radius, hertz):
    def tool(t):
        angle = 2.0 * np.pi * hertz * t
        return moved(T, radius * min(t, 1.0) * np.array([0.0, np.sin(angle), 1.0 - np.cos(angle)]))

    return tool


def stopping(tool, at):
    return lambda t: tool(min(t, at))


def goal_speeds(rig):
    return np.diff(rig.goals, axis=0) / DT


@pytest.mark.hazard(3)
@pytest.mark.parametrize(("server", "servo_law", "speed"), [
    ("lts", "none", 0.5), ("lts", "none", 1.5), ("lts", "lts", 1.0), ("lts", "lts", 1.5), ("none", "none", 1.5),
])  # fmt: skip
def test_a_fast_hand_never_trips_the_speed_stop(server, servo_law, speed):
    r = rig(server, servo_law=servo_law)
    r.follow(4.0, darting_hand(home(r), speed, 1))
    assert r.joints.stops == 0 and r.joints.max_tool_speed < STOP - 0.02
    assert r.joints.max_tool_speed > 0.4


def test_the_same_hand_without_shaping_does_trip_it():
    r = rig("none", shaping="none")
    r.follow(4.0, darting_hand(home(r), 1.5, 1))
    assert r.joints.stops > 0


@pytest.mark.parametrize("rate", [74.0, 115.0])
def test_between_frames_the_goal_continues_smoothly(rate):
    """A circle of 0.19 m/s: its joints need 3 rad/s^2; steps from frame to frame would show hundreds."""
    r = rig()
    r.follow(2.5, circle(home(r), 0.06, 0.5), rate)
    steps = np.any(np.diff(r.goals, axis=0)[5:] != 0.0, axis=1)
    assert np.mean(steps) > 0.99
    acceleration = np.diff(goal_speeds(r), axis=0) / DT
    assert np.max(np.abs(acceleration[350:])) < 8.0


@pytest.mark.parametrize("hertz", [0.25, 0.5])
def test_nothing_limited_adds_no_lag(hertz):
    """The goal is where the tool frame is at that moment, although frames come at 74 Hz only."""
    r = rig()
    tool = circle(home(r), 0.06, hertz)
    r.follow(2.5, tool)
    goals = np.array([r.rig.kinematics.forward(q)[:3, 3] for q in r.goals])
    wanted = np.array([tool(t)[:3, 3] for t in r.times])
    speed = 2.0 * np.pi * hertz * 0.06
    assert np.max(np.linalg.norm(goals - wanted, axis=1)[350:]) < 0.005 * speed + 0.0002


def out_and_back(T, way, axis, degrees, seconds):
    """A tool frame that goes a long way out, straight or turning, waits, and comes back."""

    def tool(t):
        s = 0.5 - 0.5 * np.cos(np.pi * np.clip(t / seconds, 0.0, 1.0))
        s -= 0.5 - 0.5 * np.cos(np.pi * np.clip((t - seconds - 1.0) / seconds, 0.0, 1.0))
        return moved(T, s * np.array(way), about(axis, s * np.radians(degrees)))

    return tool


HARD = {
    "wrist bent to its limit": ([0.0, 0.0, 0.0], "y", 95.0),
    "wrist bent to its limit, and aside": ([0.0, 0.02, 0.0], "y", 95.0),
    "wrist and shoulder stretched": ([0.0, 0.0, 0.0], "y", -60.0),
    "hand turned to its limit": ([0.0, 0.0, 0.0], "z", 170.0),
    "elbow stretched": ([0.3, -0.3, 0.2], "x", 40.0),
    "over the shoulder": ([-0.3, 0.3, 0.25], "y", 0.0),
    "at the top": ([-0.3, 0.3, 0.62], "y", 0.0),
    "close to the shoulder": ([-0.25, 0.25, 0.1], "x", 0.0),
    "beside the base": ([0.0, 0.5, 0.0], "x", 0.0),
    "low": ([0.1, 0.1, -0.3], "x", -30.0),
}


@functools.lru_cache(maxsize=None)
def home_degrees():
    return np.degrees(SimulatedRig().rig.home.q).tolist()


@pytest.mark.hazard(15)
@pytest.mark.parametrize(("servo_law", "where"), [
    *(("none", where) for where in HARD),
    *(("lts", where) for where in ("wrist and shoulder stretched", "hand turned to its limit", "over the shoulder")),
])  # fmt: skip
def test_singular_poses_and_joint_limits_slow_the_arm_and_let_it_back(where, servo_law):
    wide = dict(opening_angle=170.0, z_lower_limit=0.11, z_upper_limit=1.04, inner_sphere_limit=0.41)
    r = rig(servo_law=servo_law, time_out=1.0, use_home_pos=True, home_pos=home_degrees(), **wide)
    T = home(r)
    r.follow(7.0, out_and_back(T, *HARD[where], seconds=2.5))
    assert r.step.mode == "servo" and r.joints.stops == 0, r.events[-3:]
    assert r.loop.counts["ptp_motions"] == 1, "the first way home"
    limit = r.config.joint_speed * r.rig.model.max_speed
    assert np.all(np.abs(goal_speeds(r)) <= 1.01 * limit)
    assert np.all(np.abs(r.q) <= r.rig.model.upper)
    # No oscillation: while the target waits in its extreme pose the arm rests, and so it does at the end.
    for moment in (3.4, 6.9):
        around = np.abs(r.times - moment) < 0.05
        assert np.max(np.abs(r.v[around]), initial=0.0) < 0.01
    np.testing.assert_allclose(r.rig.kinematics.forward(r.q[-1]), T, atol=3e-3)
    turns = np.sum(np.diff(np.sign(np.where(np.abs(r.v) < 0.02, 0.0, r.v)), axis=0) != 0.0, axis=0)
    assert np.max(turns) < 24


@pytest.mark.parametrize(("server", "servo_law", "said"), [
    ("lts", "lts", "is lts, as set"), ("none", "none", "is none, as set"), ("lts", "none", "would follow closer"),
    ("lts", "auto", "is lts:"), ("none", "auto", "is none:"),
])  # fmt: skip
def test_the_law_is_said_at_the_start(server, servo_law, said):
    r = rig(server, servo_law=servo_law)
    assert r.step.mode == "home" and any(said in event for event in r.events)


@pytest.mark.parametrize("server", ["lts", "none"])
@pytest.mark.parametrize(("drives", "noise", "stall"), [
    (0.04, 0.0, 0.0), (0.02, 5e-5, 0.0), (0.08, 5e-5, 0.0), (0.4, 0.0, 0.0), (0.04, 0.0, 0.05), (0.04, 0.0, 0.3),
])  # fmt: skip
def test_auto_makes_goals_for_the_lts_law_where_the_arm_shows_it_without_doubt(server, drives, noise, stall):
    """`drives`: minimum trajectory time [s], longer under a reduced override; a `stall` of the control loop [s],
    again and again if it is long: after a single one the test motion is repeated."""
    r, random = SimulatedRig(server, servo_law="auto"), np.random.default_rng(1)
    r.joints = r.arm.joints = Joints(r.joints.robot, ArmSettings(servo_law=server, trajectory_time=drives))
    read, cycle, begun = r.arm.read, r._cycle, []

    def noisy():
        read()
        r.arm.state = replace(r.arm.state, joints=r.arm.state.joints + noise * random.uniform(-1.0, 1.0, 7))

    def stalling(control_on):
        cycle(control_on)
        if stall and r.step.command.__class__.__name__ == "Servo":
            begun.append(r.now)
            if len(begun) % 40 == 20 and (stall > 0.1 or len(begun) == 20):
                r.now += stall
                for _ in range(round(1e3 * stall)):
                    r.joints.step(0.001)

    r.arm.read, r._cycle = noisy, stalling
    r.at_home()
    assert r.step.mode == "home"
    sure = server == "lts" and drives < 0.1 and stall < 0.1
    assert any("is lts:" in event for event in r.events) == sure
    assert (r.loop._law is not None and r.loop._law.lts) == sure
    assert any("unclear" in event for event in r.events) == (stall > 0.1 or drives > 0.1)


@pytest.mark.parametrize("servo_law", ["lts", "auto"])
def test_a_held_arm_leaves_the_law_unclear_and_goals_as_for_none(servo_law):
    r = SimulatedRig("lts", servo_law=servo_law)
    r.joints.safety_stop = "held"
    r.at_home()
    assert r.step.mode == "home" and any("unclear" in event and "as for servo_law none" in event for event in r.events)


@pytest.mark.parametrize("hertz", [0.1, 0.5])
def test_goals_for_the_lts_law_bring_the_arm_closer_and_rest_with_it(hertz):
    behind = {}
    for servo_law in ("none", "lts"):
        r = rig("lts", servo_law=servo_law)
        tool = stopping(circle(home(r), 0.06, hertz), 2.2)
        r.follow(3.0, tool)
        arm = np.array([r.rig.kinematics.forward(q)[:3, 3] for q in r.q])
        wanted = np.array([tool(t)[:3, 3] for t in r.times])
        error = np.linalg.norm(arm - wanted, axis=1)
        behind[servo_law] = np.sqrt(np.mean(error[250:550] ** 2))
        assert np.max(np.abs(r.v[-10:])) < 0.02
    assert np.max(np.abs(np.diff(r.sent[-50:], axis=0))) < 1e-4
    assert behind["lts"] < 0.75 * behind["none"]

"""The tool stays in the workspace: steps after which it could still stop inside, and the whole stream of goals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rig_simulation")

from bench.simulated import SimulatedRig
from common.poses import translation
from iiwa_kinematics import Kinematics
from iiwa_kinematics.robot_model import ROBOTS, robot_model
from kuka_control.limits.motion_limits import MotionLimits
from kuka_control.limits.moving_arm import JointState, MovingPoints, ShapeLimits
from kuka_control.limits.speed_change import GuardedRoom, SpeedChange, StoppingGuard
from kuka_control.model.workspace import Workspace
from kuka_control.numbers import SLACK_M
from rig_description.hand import finger_balls

DT = 0.004
ALLOWED_M = 0.002
"""How far the tool point of a goal may be outside [m]."""

MODEL = robot_model("LBR7R800", "MF_elektrisch")
T_FLANGE_TOOL = np.eye(4)
T_FLANGE_TOOL[2, 3] = 0.106
ARM = Kinematics(MODEL, T_FLANGE_TOOL)
ACCELERATION = 12.0 * MODEL.max_speed / np.min(MODEL.max_speed)
JERK = ACCELERATION / 12.0 * 1000.0
WORKSPACE = Workspace([1.0, -1.0, 0.0], np.radians(50.0), 0.2, 0.6, 0.5, 0.7, MODEL.base_shoulder)
HOME = ARM.inverse(np.array([
    [-0.5**0.5, -0.5**0.5, 0.0, WORKSPACE.centre[0]],
    [0.5**0.5, -0.5**0.5, 0.0, WORKSPACE.centre[1]],
    [0.0, 0.0, 1.0, WORKSPACE.centre[2]],
    [0.0, 0.0, 0.0, 1.0],
]) @ np.diag([1.0, -1.0, -1.0, 1.0]), q_seed=np.radians([-45.0, 30.0, 0.0, -80.0, 0.0, 70.0, 0.0])).q  # fmt: skip
REST = np.zeros(7)
FINGERS = finger_balls()

postures = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(np.array)
speeds = st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7).map(np.array)
shifts = st.tuples(st.floats(-0.35, 0.35), st.floats(-0.35, 0.35), st.floats(-0.35, 0.35))
places = st.tuples(st.floats(-0.99, 0.99), st.floats(0.0, 1.0), st.floats(0.0, 1.0))


def tool_position(q):
    return ARM.forward(q)[:3, 3]


def outside(q):
    """Returns how far the tool point is outside of the workspace at joints q [m]."""
    return max(0.0, -min(WORKSPACE.rooms(tool_position(q))))


def room(workspace=WORKSPACE, speed=0.7):
    return GuardedRoom(MODEL.lower, MODEL.upper, speed, MovingPoints(ARM, FINGERS), ARM.jacobian, workspace)


balls = st.tuples(*[st.floats(-0.3, 0.3)] * 3, st.floats(0.0, 0.2))


@given(
    st.sampled_from(ROBOTS),
    st.floats(0.05, 0.3),
    st.lists(balls, max_size=4),
    st.lists(balls, max_size=4),
    postures,
    st.one_of(speeds, st.sampled_from(list(np.eye(7)))),
)
def test_no_point_is_faster_than_the_joints_times_its_reach(robot, length, carried, then, q, v):
    model = robot_model(robot, "MF_elektrisch")
    points = MovingPoints(Kinematics(model, translation(0.0, 0.0, length)), (*finger_balls(length), *carried))
    q = (q * model.upper).tolist()
    for carries in (None, then):
        if carries is not None:
            points.carry(carries)
        _, reaches = points.tool_point(q)
        assert np.abs(v) @ reaches >= points.speed(q, v.tolist()) - 1e-12


def guard(**changes):
    """Returns the change of the velocities and its guard; some tests need a tool faster than the limit."""
    change = SpeedChange(ShapeLimits(ACCELERATION, JERK))
    return change, StoppingGuard(change, room(speed=9.0, **changes), ACCELERATION)


def limits(workspace=WORKSPACE):
    result = MotionLimits(0.9 * MODEL.max_speed, ShapeLimits(ACCELERATION, JERK), room(workspace))
    result.reset(HOME)
    return result


def run(follower, targets):
    return np.array([follower.step(target, follower.goal, DT).q for target in targets])


@settings(max_examples=20)
@given(st.lists(st.tuples(speeds, st.integers(5, 60)), min_size=1, max_size=6))
def test_no_desired_velocity_carries_the_tool_out(wishes):
    change, brake = guard()
    now = JointState(HOME, REST, REST)
    for desired, steps in wishes:
        for _ in range(steps):
            now, _ = brake.step(now, desired, DT)
            assert outside(now.q) < ALLOWED_M


@settings(max_examples=30)
@given(speeds, st.integers(5, 60))
def test_what_stays_inside_is_untouched_bit_by_bit(desired, steps):
    change, brake = guard()
    now = JointState(HOME, REST, REST)
    for _ in range(steps):
        free = change.step(now, desired, DT)
        now, held = brake.step(now, desired, DT)
        if held:
            path = change.stopping(free)
            stop = [np.array(path.at_time(s * path.duration)[0]) for s in np.linspace(0.0, 1.0, 50)]
            beyond = np.any((stop[-1] > MODEL.upper) | (stop[-1] < MODEL.lower))
            assert beyond or max(outside(q) for q in stop) > SLACK_M
            return
        for taken, expected in ((now.q, free.q), (now.v, free.v), (now.a, free.a)):
            np.testing.assert_array_equal(taken, expected)


class FullGuard(StoppingGuard):
    """The guard that follows every stop, also far from all bounds."""

    def _far_from_bounds(self, state):
        return False


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_estimate_far_from_bounds_takes_the_step_of_the_full_check(seed):
    rng = np.random.default_rng(seed)
    near = HOME + rng.choice([0.0, 0.1, 1.0]) * rng.uniform(-1.0, 1.0, 7)
    q = rng.uniform(MODEL.lower, MODEL.upper) if rng.random() < 0.2 else np.clip(near, MODEL.lower, MODEL.upper)
    moving = rng.permutation(7) < rng.choice([1, 7])  # with one joint the estimate is close
    v, a = (
        rng.choice([0.0, 0.2, 1.0]) * rng.uniform(-1.0, 1.0, 7) * most * moving
        for most in (MODEL.max_speed, ACCELERATION)
    )
    points = MovingPoints(ARM, FINGERS)
    own, most = points.speed(q.tolist(), v.tolist()), float(np.abs(v) @ points.tool_point(q.tolist())[1])
    speed = max(rng.choice([0.2, 0.7, 2.0, own, 1.05 * own, 0.5 * (own + most), most]), 0.05)
    workspace = rng.choice([WORKSPACE, None])
    if rng.random() < 0.5:  # a joint that can just stop before its limit, or just not
        speed, workspace = 9.0, None
        joint = np.argmax(np.abs(v))
        v[joint] = abs(v[joint])
        q[joint] = MODEL.upper[joint] - rng.uniform(0.2, 1.2) * v[joint] ** 2 / (2.0 * ACCELERATION[joint])
    change = SpeedChange(ShapeLimits(ACCELERATION, JERK))
    bounds = room(workspace, speed)
    quick, full = (kind(change, bounds, ACCELERATION) for kind in (StoppingGuard, FullGuard))
    now = JointState(q.tolist(), v.tolist(), a.tolist())
    for _ in range(10):
        desired = (rng.choice([0.1, 1.0]) * rng.uniform(-1.0, 1.0, 7) * MODEL.max_speed * moving).tolist()
        dt = rng.uniform(0.001, 0.03)
        (now, held), (expected, expected_held) = quick.step(now, desired, dt), full.step(now, desired, dt)
        assert held == expected_held
        assert (now.q, now.v, now.a) == (expected.q, expected.v, expected.a)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_no_joint_is_faster_or_goes_further_on_the_way_to_its_stop_than_its_bounds(seed):
    rng = np.random.default_rng(seed)
    change = SpeedChange(ShapeLimits(ACCELERATION, JERK))
    v, a = (rng.choice([0.0, 0.05, 1.0]) * rng.uniform(-1.0, 1.0, 7) * most for most in (MODEL.max_speed, ACCELERATION))
    state = JointState([0.0] * 7, v.tolist(), a.tolist())
    speeds, lengths = change.stopping_bounds(state)
    path = change.stopping(state)
    times = np.linspace(0.0, path.duration, 400)
    q, v = (np.array(rows) for rows in zip(*(path.at_time(t)[:2] for t in times)))
    assert np.all(np.max(np.abs(v), axis=0) <= np.array(speeds) + 1e-9)
    assert np.all(np.sum(np.abs(np.diff(q, axis=0)), axis=0) <= np.array(lengths) + 1e-9)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_no_point_is_faster_on_the_way_to_a_stop_than_the_closer_estimate(seed):
    rng = np.random.default_rng(seed)
    change, brake = guard()
    points = brake._room.points
    v, a = (rng.choice([0.1, 1.0]) * rng.uniform(-1.0, 1.0, 7) * most for most in (MODEL.max_speed, ACCELERATION))
    v, a = (row * (rng.permutation(7) < rng.choice([2, 7])) for row in (v, a))
    state = JointState(rng.uniform(MODEL.lower, MODEL.upper).tolist(), v.tolist(), a.tolist())
    speeds, lengths = change.stopping_bounds(state)
    length = 0.0
    for i in reversed(range(7)):
        length += lengths[i] * (points.tool_point(state.q)[1][i] + length)
    bound, path = brake._fastest(state, speeds, lengths, length), change.stopping(state)
    times = np.linspace(0.0, path.duration, 60)
    assert max(points.speed(*path.at_time(t)[:2]) for t in times) <= bound + 1e-9


@settings(max_examples=8)
@given(st.lists(st.tuples(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06)), min_size=2, max_size=4))
def test_far_from_all_bounds_the_stream_is_the_same_as_without_a_brake(turns):
    targets = [HOME + np.array([a, b, 0, a, 0, b, a]) for a, b in turns for _ in range(40)]
    np.testing.assert_array_equal(run(limits(), targets), run(limits(workspace=None), targets))


@given(places, speeds)
def test_along_takes_away_the_way_out_and_nothing_else(place, desired):
    turn, out, height = place
    z = 0.2 + 0.4 * height
    inner, outer = WORKSPACE.radii(z)
    angle, r = -np.pi / 4 + turn * np.radians(25.0), inner + out * (outer - inner)
    T = ARM.forward(HOME).copy()
    T[:3, 3] = r * np.cos(angle), r * np.sin(angle), z
    q = ARM.inverse(T, q_seed=HOME).q
    if q is None or abs(q[3]) < 0.3:
        return
    _, brake = guard()
    left = brake.along(q, desired)
    rooms, normals = np.array(WORKSPACE.rooms(T[:3, 3])), WORKSPACE.outward(T[:3, 3])
    J = ARM.jacobian(q)
    acted = normals @ J[:3] @ desired > 40.0 * rooms
    assert np.all(normals @ J[:3] @ left <= np.maximum(40.0 * rooms, 0.0) + 2e-2)
    if not np.any(acted):
        np.testing.assert_allclose(left, desired, atol=1e-9)
    pace, wished = (np.max(np.abs(v) / ACCELERATION) for v in (left, desired))
    assert pace <= wished + 1e-9
    if pace > wished - 1e-9:
        return
    change = J @ (left - desired)
    assert np.linalg.norm(change[3:]) < 2e-2, "the orientation of the tool does not change"
    # The removed velocity of the tool lies in the space of the normals of the bounds near by.
    near = normals[40.0 * rooms < 3.0]
    rest = change[:3] - (np.linalg.pinv(near) @ near @ change[:3] if len(near) else 0.0)
    assert np.linalg.norm(rest) < 2e-2


@settings(max_examples=10)
@given(shifts)
def test_a_tool_that_is_outside_comes_back_in(shift):
    follower = limits()
    T = ARM.forward(HOME).copy()
    T[:3, 3] += shift
    q = ARM.inverse(T, q_seed=HOME).q
    if q is None:
        return
    follower.reset(q)
    goals = run(follower, [HOME] * 750)
    np.testing.assert_allclose(goals[-1], HOME, atol=1e-6)
    assert max(outside(goal) for goal in goals) <= outside(q) + ALLOWED_M


@pytest.mark.parametrize("beyond", [0.0, 0.001])
@pytest.mark.parametrize(("z_from", "z_to"), [(0.48, 0.28), (0.48, 0.22), (0.47, 0.28), (0.46, 0.3), (0.22, 0.47)])
def test_along_a_curved_bound_the_tool_gets_to_where_it_is_wanted(z_from, z_to, beyond):
    """The straight path of the joints leads out of the workspace; that must not stop the tool for good."""
    joints = []
    for z, outward in ((z_from, beyond), (z_to, 0.0)):
        T = ARM.forward(HOME).copy()
        r = WORKSPACE.radii(z)[1] + outward
        T[:3, 3] = 0.5**0.5 * r, -(0.5**0.5) * r, z
        joints.append(ARM.inverse(T, q_seed=HOME).q)
    follower = limits()
    follower.reset(joints[0])
    goals = run(follower, [joints[1]] * 500)
    np.testing.assert_allclose(goals[-1], joints[1], atol=1e-4)
    assert max(outside(goal) for goal in goals) < ALLOWED_M


def simulated(**changes):
    """A controller on a simulated arm, at home."""
    return SimulatedRig("none", time_out=1.0, **changes).at_home()


def home(rig):
    return rig.rig.kinematics.forward(rig.rig.home.q)


def farthest_outside(rig, rows):
    tools = (rig.rig.kinematics.forward(q)[:3, 3] for q in rows)
    return max(-min(rig.rig.workspace.rooms(tool)) for tool in tools)


def wandering(T, shifts, speed):
    """A hand that goes from shift to shift of the tool frame T, at a peak speed [m/s]."""
    times, points = [0.0, 0.2], [np.zeros(3), np.zeros(3)]
    for shift in shifts:
        points.append(np.array(shift))
        times.append(times[-1] + max(1.875 * np.linalg.norm(points[-1] - points[-2]) / speed, 0.1))

    def tool(t):
        i = min(int(np.searchsorted(times, t, side="right")) - 1, len(times) - 2)
        s = min((t - times[i]) / (times[i + 1] - times[i]), 1.0)
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        result = T.copy()
        result[:3, 3] += points[i] + s * (points[i + 1] - points[i])
        return result

    return tool


def feasible(T, shift):
    x, y, z = T[:3, 3] + shift
    return x - y > 0.1 and z > 0.02


@pytest.mark.hazard(14)
@settings(max_examples=4)
@given(st.lists(shifts, min_size=2, max_size=6), st.floats(0.2, 1.5), st.sampled_from([74.0, 115.0]))
def test_whatever_the_hand_does_the_goals_stay_in_the_workspace(moves, speed, rate):
    rig = simulated()
    T = home(rig)
    rig.follow(3.0, wandering(T, [move for move in moves if feasible(T, move)] + [np.zeros(3)], speed), rate)
    assert rig.joints.stops == 0
    assert farthest_outside(rig, rig.goals) < ALLOWED_M
    unbroken = np.diff(rig.times) < 1.5 * DT
    assert np.all(np.abs(np.diff(rig.goals, axis=0)[unbroken]) <= 1.01 * DT * 0.9 * MODEL.max_speed)


AHEAD, LEFT, UP = np.array([1.0, -1.0, 0.0]) / 2**0.5, np.array([1.0, 1.0, 0.0]) / 2**0.5, np.array([0.0, 0.0, 1.0])
AT_BOUNDS = {
    "outer sphere": (0.15 * AHEAD, 0.2 * LEFT),
    "inner sphere": (-0.2 * AHEAD, 0.12 * UP),
    "side plane": (0.4 * LEFT, 0.08 * AHEAD),
    "lower limit": (-0.3 * UP, 0.15 * LEFT),
    "edge of lower limit and outer sphere": (-0.3 * UP + 0.2 * AHEAD, 0.2 * LEFT),
}


@pytest.mark.parametrize("where", AT_BOUNDS)
def test_along_a_bound_the_tool_slides_smoothly_and_back_it_goes_freely(where):
    """The hand pushes against a bound, swings along it at 0.3 m/s, and comes back."""
    push, swing = AT_BOUNDS[where]
    rig = simulated()
    T = home(rig)

    def tool(t):
        s = np.clip(t, 0.0, 1.0) - np.clip(t - 3.0, 0.0, 1.0)
        result = T.copy()
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        result[:3, 3] += s * (push + swing * np.sin(0.3 / np.linalg.norm(swing) * np.clip(t - 1.2, 0.0, 1.8)))
        return result

    rig.follow(4.4, tool)
    assert farthest_outside(rig, rig.goals) < ALLOWED_M
    wanted = np.array([rig.rig.workspace.constrain(tool(t)[:3, 3]).position for t in rig.times])
    goals = np.array([rig.rig.kinematics.forward(q)[:3, 3] for q in rig.goals])
    sliding = (rig.times > 1.6) & (rig.times < 2.9)
    assert np.median(np.linalg.norm(goals - wanted, axis=1)[sliding]) < 0.003
    jolts = np.linalg.norm(np.diff(goals, n=2, axis=0), axis=1) / DT**2
    assert np.percentile(jolts[sliding[2:]], 90) < 3.0, "no shaking [m/s^2]"
    np.testing.assert_allclose(goals[-1], T[:3, 3], atol=1e-4)

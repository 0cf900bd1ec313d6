"""The collision guard: distances and their bounds, the stream among obstacles, and PTP motions."""

from __future__ import annotations

import sys

import hppfcl
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from loop_world import DT, HOME, Q_ASIDE, SLOW, World, ptp, rig, shifted
from test_robot_shape import signed_distances

from bench.simulated import SimulatedRig
from common.limits import Limit
from common.modes import Mode
from common.poses import pose, read_only
from common.rotations import rotation_about, rotation_from_zyx
from iiwa_kinematics import Kinematics
from kuka_control.limits.collision import NOISE_M, CollisionGuard, _Posture
from kuka_control.limits.moving_arm import GuardError
from kuka_control.loop import assembly
from kuka_control.loop.moves import MoveState
from kuka_control.loop.pending_check import CHECKED_AT_ONCE
from kuka_control.loop.transitions import State
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.obstacles import ConvexBody, ConvexShape, obstacles_from
from kuka_control.model.robot_shape import Opening
from kuka_control.model.target import MotionScaling, check_tool_pose
from kuka_control.numbers import SOFT_M

CONFIG, RIG = rig(RealTimeConfig, collision_guard=True)
MODEL, ARM = RIG.model, RIG.kinematics
MARGIN = CONFIG.guard_margin
OPEN = Opening((0.6, 0.6, 0.6), (0.1, 0.1, 0.1), 0.0)
FOLDED = Opening((3.1, 3.1, 3.1), (0.0, 0.0, 0.0), 0.0)
SHAPES = st.one_of(
    st.tuples(st.floats(0.02, 0.3), st.floats(0.02, 0.3), st.floats(0.02, 0.3)).map(
        lambda size: ConvexShape("box", size)
    ),
    st.floats(0.01, 0.12).map(lambda radius: ConvexShape("sphere", (radius,))),
    st.tuples(st.floats(0.01, 0.1), st.floats(0.02, 0.3)).map(lambda size: ConvexShape("cylinder", size)),
    st.tuples(st.floats(0.01, 0.1), st.floats(0.02, 0.3)).map(lambda size: ConvexShape("capsule", size)),
)
angles = st.floats(-3.1, 3.1)
postures = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(lambda part: np.array(part) * MODEL.upper)
turns = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(np.array)


@st.composite
def obstacles(draw, middle=HOME.centre, spread=0.45):
    T = pose(rotation_from_zyx(draw(angles), draw(angles), draw(angles)))
    T[:3, 3] = middle + [draw(st.floats(-spread, spread)) for _ in range(3)]
    return ConvexBody("post", 0, draw(SHAPES), read_only(T))


def guard(*around, opening=OPEN, margin=MARGIN, **options):
    return CollisionGuard(ARM, options.pop("ring", False), around, margin, options.pop("allowed", ("table",)), opening)


def pair_in_the_way(of, start, goal):
    """The pair that meets in a motion of all joints in step; None: nothing."""
    check = of.check((start, goal))
    check.go_on(sys.maxsize)
    return check.fault


def path_fault(of, start, goal):
    pair = pair_in_the_way(of, start, goal)
    return None if pair is None else str(pair)


def distance(around, q, opening=OPEN):
    """The smallest distance of all pairs [m], from scratch."""
    return guard(*around, opening=opening).nearest_at(list(q)).distance


def measured(q, *around, **options):
    """A guard that has measured nearly all distances at the joints q."""
    made = guard(*around, **options)
    made.near(q.tolist(), [1.0] * 7)
    return made


def stream(around, q):
    """Motion limits with a guard, at rest at the joints q."""
    made = guard(*around)
    limits = assembly.motion_limits(CONFIG, RIG, made)
    limits.reset(q)
    return limits, made


@settings(max_examples=20)
@given(postures, turns, obstacles())
def test_a_distance_is_that_of_the_bodies_and_its_bounds_hold(q, turn, post):
    made = guard(post)
    contact = made.nearest_at(q.tolist())
    placed = {body.name: pose(T[:3, :3], T[:3, 3]) for body, T in made.placed(q.tolist())}
    bodies = {body.name: body for body in made.bodies}
    if contact.distance > 1e-3:
        gap = contact.points[1] - contact.points[0]
        assert np.linalg.norm(gap) == pytest.approx(contact.distance, abs=2e-5)
        for name, point in zip(contact.pair, contact.points):
            body = ConvexBody(name, 0, bodies[name].shape, placed[name])
            assert abs(signed_distances(point[None], body)[0]) < 1e-4, "the nearest points lie on the surfaces"
    other = q + 0.2 * turn
    nearest = made.nearest_at(other.tolist())
    again = guard(post).nearest_at(other.tolist())
    assert nearest.distance == pytest.approx(again.distance, abs=2e-6), "what was left out was farther"
    left, slowed = made.slowed(other.tolist(), turn.tolist())
    assert np.max(np.abs(np.array(left)) / MODEL.max_speed) <= np.max(np.abs(turn) / MODEL.max_speed) + 1e-9
    if slowed:
        step = 1e-5
        then = guard(post).nearest_at((other + step * np.array(left)).tolist())
        if again.distance < MARGIN + SOFT_M:
            assert then.distance >= min(again.distance, MARGIN + SOFT_M) - 2e-6, "what is too near does not come nearer"


@settings(max_examples=20)
@given(postures, turns, obstacles())
def test_far_stays_far(q, turn, post):
    made = guard(post)
    made.nearest_at(q.tolist())
    lengths = 0.05 * np.abs(turn)
    if not made.near(q.tolist(), lengths.tolist()):
        watch = guard(post)
        for factor in (-1.0, -0.4, 0.5, 1.0):
            assert watch.nearest_at((q + factor * lengths).tolist()).distance >= MARGIN


def test_a_stretched_arm_that_turns_into_a_post_does_not_stay_far():
    q, turn = np.zeros(7), np.zeros(7)
    post = ConvexBody("post", 0, ConvexShape("sphere", (0.05,)), read_only(pose(p=ARM.forward(q)[:3, 3] + [0.4, 0, 0])))
    made, watch = guard(post), guard(post)
    made.nearest_at(q.tolist())
    while watch.nearest_at((q + turn).tolist()).distance >= MARGIN:
        assert turn[1] < 1.0
        turn[1] += 0.005
    assert not made.near(q.tolist(), [0.01] * 7) and made.near(q.tolist(), turn.tolist())


def test_the_distance_of_palm_and_sphere_is_that_of_the_drawing():
    """A sphere below the palm: the answer in closed form."""
    T = ARM.forward(HOME.q)  # the tool points down; the hand's mounting face is 80 mm above the tool point
    below = read_only(pose(p=T[:3, 3] - np.array([0.0, 0.0, 0.014 + 0.05 + 0.08])))
    post = ConvexBody("post", 0, ConvexShape("sphere", (0.05,)), below)
    contact = guard(post, opening=FOLDED, allowed=("table", "post")).nearest_at(HOME.q.tolist())
    assert contact.pair == ("palm", "post")
    assert contact.distance == pytest.approx(0.08, abs=1e-6)


def path(waypoints):
    """Joint targets of a tool that moves between waypoints [m] from home and back the same way; at rest at each."""
    targets, q = [], HOME.q
    points = [np.zeros(3), *map(np.array, waypoints)]
    points += points[-2::-1]
    for a, b in zip(points, points[1:]):
        steps = max(round(float(np.linalg.norm(b - a)) / 0.35 / DT), 10)
        for s in (np.arange(steps) + 1.0) / steps:
            s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
            found = ARM.inverse(shifted(*(a + s * (b - a))), q_seed=q, keep_branch=True).q
            q = q if found is None else found
            targets.append(q)
    return targets


@pytest.mark.hazard(16)
@settings(max_examples=6, deadline=None)
@given(
    st.lists(obstacles(spread=0.3), min_size=2, max_size=5),
    st.lists(st.tuples(*[st.floats(-0.25, 0.25)] * 3), min_size=1, max_size=2),
)
def test_any_hand_among_any_obstacles_stays_out_keeps_its_limits_and_comes_back(posts, waypoints):
    posts = [post for post in posts if distance([post], HOME.q) > MARGIN + 0.01]
    limits, made = stream(posts, HOME.q)
    goals = [limits.goal]
    targets = path(waypoints)
    for target in targets + [HOME.q] * 500:
        goals.append(limits.step(target, limits.goal, DT).q)
    watch = guard(*posts)
    least = min(watch.nearest_at(q.tolist()).distance for q in goals)
    assert least >= MARGIN - NOISE_M
    v = np.diff(goals, axis=0) / DT
    pace = MODEL.max_speed / np.min(MODEL.max_speed)
    assert np.all(np.abs(v) <= 0.91 * MODEL.max_speed)
    assert np.all(np.abs(np.diff(v, axis=0)) / DT <= 1.01 * CONFIG.joint_acceleration * pace)
    assert np.all(np.abs(np.diff(v, n=2, axis=0)) / DT**2 <= 1.05 * CONFIG.joint_jerk * pace + 1.0)
    np.testing.assert_allclose(goals[-1], HOME.q, atol=1e-3, err_msg="the way back is taken")


ACROSS = np.array([0.5**0.5, 0.5**0.5, 0.0])  # to the side of the arm at home
OUT = np.array([0.5**0.5, -(0.5**0.5), 0.0])


def wall(x, name="wall"):
    """A wall beside the hand at home, its face `x` [m] from the middle of the workspace."""
    T = pose(rotation_about(2, np.pi / 4.0), HOME.centre + (x + 0.01) * ACROSS - [0.0, 0.0, 0.05])
    return ConvexBody(name, 0, ConvexShape("box", (0.02, 0.6, 0.3)), read_only(T))


def aside(x, out=0.0):
    """The home tool frame, moved towards the wall by `x` and outwards by `out` [m]."""
    return shifted(*(x * ACROSS + out * OUT))


def joints(x):
    return ARM.inverse(aside(x), q_seed=HOME.q, keep_branch=True).q


WALL = wall(0.21)


def to_wall(q, *around):
    """The distance of the robot from a wall, or from obstacles [m]."""
    around = around or (WALL,)
    made, posture = guard(*around), _Posture(ARM, list(q))
    return min(made._distance(n, posture) for n, (_, j) in enumerate(made._pairs) if made.bodies[j] in around)


def test_the_arm_slows_down_before_a_wall_slides_along_it_and_comes_back():
    limits, made = stream([WALL], HOME.q)
    watch, names, at = guard(WALL), set(), []
    for i in range(900):
        push = aside(min(0.35 * i * DT, 0.2), 0.05 * np.sin(0.01 * max(i - 300, 0)))
        q = ARM.inverse(push, q_seed=limits.goal, keep_branch=True).q
        step = limits.step(q, limits.goal, DT)
        names.add(step.limited_by)
        at.append(ARM.forward(step.q))
        assert watch.nearest_at(step.q.tolist()).distance >= MARGIN - NOISE_M
    assert Limit.COLLISION_GUARD in names and made.scale < 0.2
    assert made.nearest.pair[1] == "wall" and made.nearest.distance < MARGIN + 2.0 * SOFT_M
    assert np.ptp([OUT @ T[:3, 3] for T in at[300:]]) > 0.08, "it slides along"
    turns = [np.degrees(np.arccos(np.clip((np.trace(T[:3, :3].T @ at[0][:3, :3]) - 1.0) / 2.0, -1.0, 1.0))) for T in at]
    assert max(turns) < 5.0, "without turning"
    for _ in range(500):
        step = limits.step(HOME.q, limits.goal, DT)
    np.testing.assert_allclose(step.q, HOME.q, atol=1e-6)
    assert step.limited_by is None and made.scale == 1.0


@pytest.mark.parametrize("speed", [0.1, 0.35, 0.6])
def test_the_guard_of_stops_alone_keeps_the_margin(speed):
    """No approach is slowed down, and the hand comes to the wall's edge as fast as it can."""
    limits, made = stream([WALL], HOME.q)
    made.slowed = lambda q, desired: (list(desired), False)
    watch, names = guard(WALL), set()
    for i in range(400):
        push = aside(min(speed * i * DT, 0.2), 0.1 * np.sin(0.02 * i))
        step = limits.step(ARM.inverse(push, q_seed=limits.goal, keep_branch=True).q, limits.goal, DT)
        names.add(step.limited_by)
        assert watch.nearest_at(step.q.tolist()).distance >= MARGIN - NOISE_M
    assert Limit.COLLISION_GUARD in names


def test_from_too_near_only_what_parts_is_allowed():
    """An obstacle appeared 1 cm before the fingers."""
    q = HOME.q
    near = wall(0.21 - to_wall(q) + 0.01)
    assert distance([near], q) == pytest.approx(0.01, abs=1e-5)
    limits, watch = stream([near], q)[0], guard(near)
    before = watch.nearest_at(list(q)).distance
    for x in (0.1, -0.1):
        goal = joints(x)
        for _ in range(200):
            limits.step(goal, limits.goal, DT)
            now = watch.nearest_at(limits.goal.tolist()).distance
            assert now >= min(before, MARGIN) - 2.0 * NOISE_M
            before = now
    np.testing.assert_allclose(limits.goal, goal, atol=1e-3)


def beside(normal, gap, q=HOME.q, size=(0.02, 0.6, 0.3)):
    """A wall in the direction `normal` of the middle of the workspace, `gap` [m] from the robot at the joints q."""

    def placed(x):
        T = pose(rotation_about(2, np.arctan2(normal[1], normal[0])), HOME.centre + x * normal - [0.0, 0.0, 0.05])
        return ConvexBody("post", 0, ConvexShape("box", size), read_only(T))

    return placed(0.2 + gap - to_wall(q, placed(0.2)))


def approach(obstacle, v):
    """How fast the robot at home comes nearer to an obstacle with the joint velocities v [m/s]."""
    step = 3e-4
    before, after = (to_wall(HOME.q + s * np.array(v), obstacle) for s in (-step, step))
    return (before - after) / (2.0 * step)


def hand(v):
    """The joint velocities that move the hand at home with the velocity v, without turning it [rad/s]."""
    return np.linalg.pinv(ARM.jacobian(HOME.q)) @ np.array([*v, 0.0, 0.0, 0.0])


@settings(max_examples=20, deadline=None)
@example(-2.220446049250313e-16, 1.0, None, -1)  # they touch, and by rounding overlap
@example(-2.220446049250313e-16, 1.0, None, 1)
@given(
    st.floats(-0.01, 0.15), st.floats(0.02, 1.0), st.one_of(st.just(None), st.integers(0, 6)), st.sampled_from((-1, 1))
)
def test_an_approach_ends_before_the_margin_at_2_m_s2_and_a_retreat_is_free(gap, speed, joint, sign):
    """Of the hand as a whole, and by each joint alone; a negative gap: they overlap."""
    face, room = beside(ACROSS, gap), max(gap - MARGIN - SOFT_M, 0.0)
    v = sign * speed * (hand(ACROSS) if joint is None else np.eye(7)[joint])
    left, slowed = measured(HOME.q, face).slowed(HOME.q.tolist(), v.tolist())
    after = approach(face, left)
    assert after <= 20.0 * room + 5e-3 and max(after, 0.0) ** 2 / (2.0 * 2.0) <= room + 1e-4
    assert np.max(np.abs(left) / MODEL.max_speed) <= np.max(np.abs(v) / MODEL.max_speed) + 1e-9
    if joint is None and sign < 0:
        assert not slowed and left == v.tolist()
    if joint is None and sign > 0:
        most = 20.0 * room if room <= 0.005 else (4.0 * (room - 0.0025)) ** 0.5
        assert after == pytest.approx(min(speed, most), abs=5e-3), "no slower than it must be"


def test_in_a_wedge_the_hand_stops_before_both_walls():
    """Five passes over the two corrections do not end there."""
    sides = [sign * ACROSS + 0.3 * OUT for sign in (1.0, -1.0)]
    walls = [beside(side / np.linalg.norm(side), MARGIN + SOFT_M) for side in sides]
    v = hand(0.4 * OUT)
    assert all(approach(face, v) > 0.03 for face in walls)
    left, slowed = guard(*walls).slowed(HOME.q.tolist(), v.tolist())
    assert slowed and all(approach(face, left) < 5e-3 for face in walls)


def any_opening(rng):
    return Opening(tuple(rng.uniform(0.0, 3.1, 3)), tuple(rng.uniform(0.0, 1.5, 3)), rng.uniform(0.0, 1.5))


@pytest.mark.parametrize("known", [False, True])
def test_no_pair_that_has_come_near_is_missed_while_the_arm_moves(known):
    rng = np.random.default_rng(1)
    for _ in range(40):
        q, length = rng.uniform(-1.0, 1.0, 7) * MODEL.upper, [rng.uniform(0.02, 0.3)] * 7
        opening = any_opening(rng) if known else None
        other = (q + rng.uniform(-0.5, 0.5, 7)).tolist()
        made, new = measured(q, WALL, opening=opening), guard(WALL, opening=opening)
        assert made.near(other, length) == new.near(other, length)


def test_which_bodies_of_the_robot_keep_away_from_which():
    made = guard(WALL)
    watched = {}
    for i, j in made._pairs:
        watched.setdefault(made.bodies[j].name, set()).add(made.bodies[i].link)
    around, beyond = {2, 3, 4, 5, 6, 7}, {6, 7}
    assert watched == {
        **{name: around for name in ("wall", "table")},
        **{name: {5, *beyond} for name in ("base", "base plugs", "link 1")},
        **{name: beyond for name in ("link 2", "link 3")},
        **{name: {7} for name in ("link 4", "link 5")},
    }


def test_a_calibrated_arm_keeps_what_it_may_differ_by_besides():
    plain, calibrated = guard(WALL), Kinematics(MODEL, ARM.T_flange_tool)
    calibrated.slack = 0.002, 0.004
    made = CollisionGuard(calibrated, False, [WALL], MARGIN, ("table",), OPEN)
    at = HOME.q.tolist()
    assert made.nearest_at(at).distance == pytest.approx(plain.nearest_at(at).distance - 0.008, abs=2.0 * NOISE_M)


@settings(max_examples=8, deadline=None)
@given(postures, postures, obstacles(middle=np.zeros(3), spread=0.9))
def test_a_motion_that_is_free_is_free_between_its_samples(start, goal, post):
    if path_fault(guard(post), start, goal) is not None:
        return
    watch = guard(post)
    floor = min(distance([post], start), MARGIN)
    for s in np.linspace(0.0, 1.0, 300):
        assert watch.nearest_at((start + s * (goal - start)).tolist()).distance >= floor - 2.0 * NOISE_M


openings = st.builds(
    Opening,
    st.tuples(*[st.floats(0.0, np.pi)] * 3),
    st.tuples(*[st.one_of(st.just(0.0), st.floats(0.0, 1.1))] * 3),
    st.floats(0.0, 1.75),
)


def fingers_to(ball, opening):
    """The distance of the fingers at home from an obstacle [m]."""
    made, posture = guard(ball, opening=opening), _Posture(ARM, HOME.q.tolist())
    pairs = [n for n, (i, j) in enumerate(made._pairs) if made.bodies[i].finger and made.bodies[j] is ball]
    return min(made._distance(n, posture) for n in pairs)


@settings(max_examples=60, deadline=None)
@example(Opening((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0), 0.0, 0.0)
@example(Opening((np.pi / 2.0,) * 3, (0.0, 0.0, 0.0), 1.0), 0.0, -1.5)
@given(openings, st.floats(-np.pi, np.pi), st.floats(-1.5, 1.0))
def test_at_no_opening_is_a_finger_nearer_than_its_reach(opening, around, up):
    """To a small ball somewhere around the hand at home."""
    out = 0.3 * (np.cos(up) * (np.cos(around) * OUT + np.sin(around) * ACROSS) + np.sin(up) * np.array([0.0, 0.0, 1.0]))
    ball = ConvexBody("ball", 0, ConvexShape("sphere", (0.01,)), read_only(pose(p=HOME.T_base_tool[:3, 3] + out)))
    assert fingers_to(ball, opening) >= fingers_to(ball, None) - 2.0 * NOISE_M


@pytest.mark.hazard(16)
@settings(max_examples=8, deadline=None)
@given(postures, postures, obstacles(middle=np.zeros(3), spread=0.9), st.lists(openings, min_size=2, max_size=4))
def test_a_motion_that_starts_is_free_for_fingers_that_move_on_the_way(start, goal, post, moved):
    """However they open, close and spread meanwhile."""
    made = CollisionGuard(ARM, False, [post], MARGIN, ("table",))
    if made.fault_at(start) is not None or path_fault(made, start, goal) is not None:
        return
    rows = np.array([[*o.proximal, *o.distal, o.preshape] for o in moved])
    for s in np.linspace(0.0, 1.0, 60):
        at = [float(np.interp(s, np.linspace(0.0, 1.0, len(moved)), column)) for column in rows.T]
        opening = Opening(tuple(at[:3]), tuple(at[3:6]), at[6])
        assert distance([post], start + s * (goal - start), opening) >= MARGIN - 2.0 * NOISE_M


@pytest.mark.hazard(4)
def test_a_motion_into_a_post_is_refused_by_name_and_one_out_of_it_allowed():
    q = joints(0.2)
    assert "wall" in path_fault(guard(WALL), HOME.q, q)
    assert path_fault(guard(WALL), HOME.q, HOME.q) is None
    held = joints(to_wall(HOME.q) - 0.02)
    assert distance([WALL], held) < MARGIN
    assert path_fault(guard(WALL), held, HOME.q) is None


@pytest.mark.parametrize("method", ["slowed", "near", "depths", "nearest_at", "follow", "follow from"])
def test_what_is_not_a_number_is_an_error(method):
    bad = [float("nan"), *[0.0] * 6]
    arguments = {
        **{"depths": [bad, [0]], "nearest_at": [bad]},
        **{"follow": [bad, HOME.q, DT], "follow from": [HOME.q.tolist(), np.array(bad), DT]},
    }.get(method, [bad, [0.1] * 7])
    method = method.split()[0]
    with pytest.raises(GuardError):
        getattr(guard(WALL), method)(*arguments)


def test_a_failure_of_the_library_stops_the_arm(monkeypatch):
    limits, _ = stream([WALL], HOME.q)
    q = joints(0.2)
    monkeypatch.setattr(hppfcl, "distance", lambda *_: float("nan"))
    with pytest.raises(GuardError, match="nan"):
        for _ in range(200):
            limits.step(q, limits.goal, DT)


@pytest.mark.parametrize("gap, words", [(-0.02, "would hit the wall"), (0.01, "10 mm from the wall, not 30 mm")])
def test_a_tool_pose_that_collides_is_refused_with_the_pair(gap, words):
    face = wall(0.21 - to_wall(HOME.q) + gap)
    answer = check_tool_pose(RIG.chain, HOME.T_base_tool, MotionScaling(), HOME.q, False, guard(face).fault_at)
    assert answer.q is None and words in answer.sentence and words in answer.obstacle
    beyond = check_tool_pose(RIG.chain, aside(-0.1), MotionScaling(), HOME.q, False, guard(face).fault_at)
    assert beyond.q is not None
    following = check_tool_pose(RIG.chain, HOME.T_base_tool, MotionScaling(), HOME.q, True, guard(face).fault_at)
    assert following.q is None and following.obstacle is None, "an arm that follows comes as near as it may"


def test_the_fingers_may_touch_what_is_allowed_but_the_palm_may_not():
    for allowed, names in (((), "finger"), (("wall",), "palm")):
        spread = Opening((0.6, 0.6, 0.6), (0.1, 0.1, 0.1), 1.5)
        made = guard(WALL, allowed=("table", *allowed), opening=spread)
        q = joints(0.2)
        pair = pair_in_the_way(made, HOME.q, q)
        assert names in str(pair) and pair.finger is (names == "finger")


def guarded_world():
    """A world whose real-time controller knows of table and base."""
    return World(collision_guard=True)


def place(world, *around):
    """Bodies appear."""
    world.loop._settings.guard.__init__(ARM, False, around, MARGIN, ("table",))


def test_a_pick_up_that_is_blocked_is_refused_and_the_arm_stays_until_the_hand_is_elsewhere():
    world = guarded_world().at_home()
    place(world, WALL)
    world.control_on = True
    world.run(1.0, aside(0.2))
    assert world.mode == Mode.HOME and not world.arm.commands
    assert "wall" in world.steps[-1].reason and sum("refuses" in event for event in world.events) == 1
    world.until("servo", 4.0, aside(-0.05))


@pytest.mark.parametrize("opening", [FOLDED, OPEN, None])
def test_a_way_home_that_only_moving_fingers_would_block_is_refused_and_the_sentence_says_so(opening):
    """The folded hand would pass by the post; fingers open 0.2 s after the hand was lost, while the arm goes home."""
    world = guarded_world().following(aside(0.2))
    at = HOME.centre + 0.1 * ACROSS + 0.22 * OUT
    post = ConvexBody("post", 0, ConvexShape("capsule", (0.01, 0.3)), read_only(pose(p=at)))
    assert path_fault(guard(post, opening=FOLDED), world.arm.q, HOME.q) is None
    assert path_fault(guard(post, opening=OPEN), world.arm.q, HOME.q) is None
    assert guard(post, opening=None).fault_at(world.arm.q) is None
    place(world, post)
    world.loop.open_hand(opening)
    world.run(1.0)
    assert world.mode == Mode.STOPPED and not any(command[0] == "ptp" for command in world.arm.commands)
    assert "reach of finger" in world.steps[-1].reason and "the post; it keeps 30 mm" in world.steps[-1].reason
    assert "A finger that opens or closes meanwhile could come that near" in world.steps[-1].reason


def test_fingers_that_open_and_close_in_the_stream_do_not_come_nearer_than_the_margin():
    world = guarded_world().following()
    place(world, WALL)
    rng = np.random.default_rng(1)
    for cycle in range(300):
        opening = any_opening(rng)
        world.loop.open_hand(opening)
        world.run(DT, aside(min(0.2 * cycle * DT, 0.2)))
        assert distance([WALL], world.arm.q, opening) >= MARGIN - NOISE_M
    assert world.mode == Mode.SERVO and Limit.COLLISION_GUARD in world.steps[-1].limited_by


def orbit(post, radius, speed, sway, turn):
    """A tool that goes around a post, and would pass through it, as fast as it is followed; of the time [s]."""
    ahead = HOME.centre - post

    def tool(t):
        s = min(t / 0.6, 1.0)
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        angle = speed / max(radius, 0.1) * max(t - 0.6, 0.0)
        out = np.linalg.norm(ahead) * (1.0 - s) + s * (radius + sway * np.sin(6.0 * t))
        T = shifted(*(post - HOME.centre + rotation_about(2, angle) @ ahead / np.linalg.norm(ahead) * out))
        T[:3, :3] = T[:3, :3] @ rotation_about(2, turn * np.sin(5.0 * t))
        return T

    return tool


@pytest.mark.hazard(16)
@settings(max_examples=6, deadline=None)
@example("lts", 1.33, 0.13, 0.27, 0.07, 0.64)
@example("none", 1.3, 0.14, 0.32, 0.09, 0.36)
@given(
    *(st.sampled_from(("lts", "none")), st.floats(0.0, 6.28), st.floats(0.05, 0.2)),
    *(st.floats(0.2, 0.6), st.floats(0.0, 0.12), st.floats(-0.8, 0.8)),
)
def test_an_arm_that_lags_behind_its_goals_keeps_the_margin_around_a_post(law, side, radius, speed, sway, turn):
    """Its joints lag unevenly, so that it cuts the corners of the path of the goals."""
    middle = HOME.centre + 0.3 * np.array([np.cos(side), np.sin(side), 0.0])
    post = ConvexBody("post", 0, ConvexShape("capsule", (0.02, 0.4)), read_only(pose(p=middle)))
    watch = guard(post, opening=None)
    assume(watch.nearest_at(HOME.q.tolist()).distance > MARGIN + 0.01)
    rig = SimulatedRig(law, collision_guard=True).at_home()
    rig.loop._settings.guard.__init__(ARM, False, [post], MARGIN, ("table",))
    rig.follow(2.0, orbit(middle, radius, speed, sway, turn))
    assert len(rig.q) > 200
    assert min(watch.nearest_at(q.tolist()).distance for q in rig.goals[::2]) >= MARGIN - NOISE_M
    assert min(watch.nearest_at(q.tolist()).distance for q in rig.q[::2]) >= MARGIN


def test_a_hand_behind_a_wall_is_followed_to_the_wall_and_the_reason_names_it():
    world = guarded_world().following()
    place(world, WALL)
    world.run(1.5, lambda t: aside(min(0.2 * t, 0.2)))
    assert world.mode == Mode.SERVO and Limit.COLLISION_GUARD in world.steps[-1].limited_by
    assert "holds the arm back" in world.steps[-1].reason and "wall" in world.steps[-1].reason
    assert distance([WALL], world.arm.q) >= MARGIN - NOISE_M
    world.run(1.5, lambda t: aside(max(0.2 - 0.2 * t, 0.0)))
    np.testing.assert_allclose(world.arm.q, HOME.q, atol=1e-3)


@pytest.mark.parametrize("change", ["off", "again", "cancel", "exit"])
def test_a_motion_does_not_begin_if_what_asked_for_it_ends_while_its_way_is_checked(change):
    world = guarded_world().at_home()
    world.control_on = True
    world.ask("aside").run(DT)
    assert not world.arm.commands and world.progress.state is MoveState.RUNNING and world.loop.counts["moves"] == 0
    if change == "cancel":
        world.cancel()
    elif change == "exit":
        world.exit_requested = True
    else:
        world.control_on = False
        world.control_on = change == "again"
    world.run(1.0)
    goal = ptp(Q_ASIDE, SLOW)
    assert (goal in world.arm.commands) == (change == "again")
    assert world.progress.state is (MoveState.DONE if change == "again" else MoveState.REFUSED)


def test_a_pick_up_does_not_begin_if_control_goes_off_while_its_way_is_checked():
    for off in (True, False):
        world = guarded_world().at_home()
        world.control_on = True
        while not world.loop._path.continues:
            world.run(DT, aside(-0.1))
        assert not world.arm.commands and world.mode == Mode.HOME
        world.control_on = not off
        world.run(0.3)
        assert any(command[0] == "ptp" for command in world.arm.commands) == (not off)


def test_one_cycle_checks_a_part_of_a_way_only(monkeypatch):
    world = guarded_world().at_home()
    shelf = ConvexBody("shelf", 0, ConvexShape("box", (3.0, 3.0, 0.05)), read_only(pose(p=(0.0, 0.0, 0.1))))
    place(world, shelf)
    world.control_on = True
    asked, measured = hppfcl.distance, []
    monkeypatch.setattr(hppfcl, "distance", lambda *arguments: measured.append(1) or asked(*arguments))
    world.ask(HOME.q + np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]))
    total = 0
    while world.state is State.HOME and total < 100 * CHECKED_AT_ONCE:
        measured.clear()
        world.run(DT)
        total += len(measured)
        assert len(measured) <= CHECKED_AT_ONCE + 2
    assert world.state is State.TO_GOAL and total > 2 * CHECKED_AT_ONCE


def test_what_is_wide_at_the_flange_does_not_reach_the_forearm():
    around = obstacles_from(
        {"plate": {"kind": "box", "size": [0.25, 0.02, 0.25], "position": [0.0, 0.15, 0.05], "frame": "flange"}},
        MODEL.wrist_flange,
    )
    made = guard(*around)
    q = np.radians([-13.0, 76.0, -62.0, -47.0, -62.0, 119.0, -128.0])
    nearest = made.nearest_at(q.tolist())
    assert nearest.distance < 0.0 and nearest.pair[0] == "plate" and nearest.pair[1] in ("link 4", "link 5")
    assert path_fault(made, HOME.q, q) is not None
    pairs = {(made.bodies[i].name, made.bodies[j].name) for i, j in made._pairs}
    assert {("palm", "link 4"), ("palm", "link 5")} <= pairs


def test_a_line_that_is_accepted_ends_where_a_stream_gets_to():
    for gap, free in ((0.0005, False), (0.0025, False), (0.0045, True)):
        made = guard(wall(0.21 - to_wall(HOME.q) + MARGIN + gap))
        check = made.check((joints(-0.02), HOME.q), True)
        check.go_on(10000)
        assert check.done and (check.fault is None) == free
    limits = assembly.motion_limits(CONFIG, RIG, made)
    limits.reset(joints(-0.02))
    for _ in range(200):
        limits.step(HOME.q, limits.goal, DT)
    np.testing.assert_allclose(limits.goal, HOME.q, atol=1e-9)


def test_at_rest_the_guard_leaves_everything():
    world = guarded_world().following()
    place(world, WALL)
    world.run(1.5, lambda t: aside(min(0.2 * t, 0.2)))
    assert world.loop.guard_scale < 1.0
    world.control_on = False
    world.until("home", 4.0)
    assert world.loop.guard_scale == 1.0

"""Arms in one world: their workspaces keep the margin, by the nearest points of the filled workspaces."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import hppfcl
import numpy as np
import pytest
import yaml
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from loop_world import DT, rig
from test_workspace import SETTINGS, beyond, workspaces

from common.arms import arms_from
from common.config import parse
from common.errors import ConfigError
from common.poses import inverse, pose
from common.rotations import rotation_from_zyx
from kuka_control.limits.collision import NOISE_M, CollisionGuard, _geometry, _transform
from kuka_control.loop import assembly
from kuka_control.model.arms import WALL_M, filled, nearest_points, placement_faults, walls
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.rig import workspace_of
from kuka_control.model.robot_shape import Opening

CONFIG = Path(__file__).parents[1] / "config"
TWO = yaml.safe_load((CONFIG / "two_arms.yaml").read_text())
UPRIGHT = np.zeros(3)


CONFIGURED = {
    key: value
    for name in ("kuka_params_rt.yaml", "arm_of_two.yaml")
    for key, value in yaml.safe_load((CONFIG / name).read_text()).items()
}


def shipped():
    return workspace_of(parse(RealTimeConfig, CONFIGURED))


@st.composite
def placed(draw):
    """A workspace, and where its base stands."""
    angles = [draw(st.floats(-np.pi, np.pi)) for _ in range(3)]
    return draw(workspaces()), pose(rotation_from_zyx(*angles), [draw(st.floats(-1.5, 1.5)) for _ in range(3)])


def beyond_filled(workspace, T_world_base, position):
    """How far a position in world is outside the workspace without its hollow [m]."""
    whole = SimpleNamespace(**{**{name: getattr(workspace, name) for name in SETTINGS}, "inner_sphere": 0.0})
    return beyond(whole, (inverse(T_world_base) @ [*position, 1.0])[:3])


def sampled(workspace, T_world_base, random):
    """Positions in the workspace without its hollow, in world, shape (n, 3); its corners among them."""
    x, y = workspace.center_line[:2]
    edges = np.array([-1.0, 0.0, 1.0]) * workspace.opening_angle / 2.0
    turns = np.arctan2(y, x) + np.concatenate([edges, random.uniform(edges[0], edges[2], 8)])
    heights = np.concatenate(
        [[workspace.z_lower, workspace.z_upper], random.uniform(workspace.z_lower, workspace.z_upper, 6)]
    )
    points = [
        (share * r * np.cos(turn), share * r * np.sin(turn), z)
        for z in heights
        for r in [workspace.radii(z)[1]]
        for turn in turns
        for share in (0.0, random.uniform(), 1.0)
    ]
    return np.array(points) @ T_world_base[:3, :3].T + T_world_base[:3, 3]


@settings(max_examples=40)
@given(placed(), placed(), st.integers(0, 2**32 - 1))
def test_no_points_are_nearer_and_two_are_so_near(first, second, seed):
    nearest = nearest_points(filled(*first), filled(*second))
    for body, point in zip((first, second), nearest.points):
        assert beyond_filled(*body, point) < 1e-9
    assert -1e-12 <= np.linalg.norm(np.subtract(*nearest.points)) - nearest.distance < 2e-6
    random = np.random.default_rng(seed)
    here, there = sampled(*first, random), sampled(*second, random)
    least = np.linalg.norm(here[:, None] - there[None], axis=2).min()
    assert nearest.distance <= least + 1e-12


@settings(max_examples=30)
@given(placed(), placed(), placed())
def test_the_distance_is_symmetrical_and_does_not_depend_on_where_world_is(first, second, other):
    T = other[1]
    there = nearest_points(filled(second[0], T @ second[1]), filled(first[0], T @ first[1]))
    assert nearest_points(filled(*first), filled(*second)).distance == pytest.approx(there.distance, abs=3e-6)


def test_the_shipped_arms_keep_their_margin_and_would_not_nearer():
    arms = arms_from(TWO)
    both = dict.fromkeys(arms.placements, shipped())
    assert [placement_faults(arms, name, UPRIGHT, both) for name in both] == [[], []]
    near = arms_from({**TWO, "left": {"position": [0, 0.44, 0]}})
    for name, other in (("left", "right"), ("right", "left")):
        (fault,) = placement_faults(near, name, UPRIGHT, both)
        assert f"{name} and {other} are 0.298 m apart" in fault and "arms/margin is 0.3 m" in fault


def test_the_vertical_of_both_parameters_must_agree_whatever_the_yaw():
    arms = arms_from({**TWO, "left": {"position": [0, 1.5, 1.5], "rpy": [180, 0, 90]}})
    both = dict.fromkeys(arms.placements, shipped())
    assert placement_faults(arms, "left", np.array([180.0, 0.0, 0.0]), both) == []
    (fault,) = placement_faults(arms, "left", UPRIGHT, both)
    assert "arms/left/rpy" in fault and "left/kuka/mounting is [0.0, 0.0, 0.0] deg" in fault


def test_bases_that_nearly_touch_are_refused_whatever_the_workspaces():
    """Back to back: the workspaces are far apart."""
    arms = arms_from({"margin": 0.3, "left": {"position": [0, 0, 0]}, "right": {"position": [-0.5, 0, 0]}})
    back = workspace_of(parse(RealTimeConfig, {**CONFIGURED, "center_line": [-1, 0, 0]}))
    (fault,) = placement_faults(arms, "left", UPRIGHT, {"left": shipped(), "right": back})
    assert "The bases of left and right are 0.500 m apart" in fault and "must be 0.6 m" in fault


LIFTED, FREE = rig(RealTimeConfig, lifted=True, collision_guard=True, center_line=(1, 0, 0))
MARGIN, KINEMATICS, HOME = LIFTED.guard_margin, FREE.kinematics, FREE.home
APART_M = 2.0 * MARGIN + WALL_M
OPENINGS = Opening((0.6, 0.6, 0.6), (0.1, 0.1, 0.1), 0.0), None  # known; and not known: as wide as it can be


def standing(y, yaw):
    """Both arms beside each other, from `y` to y + 0.25 [m] off the middle, turned by at most `yaw` [deg]."""
    bases = {
        name: st.fixed_dictionaries({
            "position": st.tuples(st.floats(-0.1, 0.1), st.floats(y, y + 0.25), st.floats(-0.1, 0.1)).map(
                lambda p, sign=sign: [p[0], sign * p[1], p[2]]
            ),
            "rpy": st.floats(-yaw, yaw).map(lambda angle: [0.0, 0.0, angle]),
        })
        for name, sign in (("left", 1.0), ("right", -1.0))
    }  # fmt: skip
    return st.fixed_dictionaries({"margin": st.just(0.3), **bases})


def guards(arms, opening):
    """The guard of each arm, with the walls between them."""
    made = {}
    for name in arms.placements:
        made[name] = CollisionGuard(KINEMATICS, False, walls(arms, name), MARGIN, LIFTED.allow_contact, opening)
    return made


def parts(guard, arm, q):
    """The bodies of a robot, without what stands around it, and their poses in world."""
    for body, T in guard.placed(q.tolist()):
        if body.name != "table" and not body.name.startswith("side of"):
            yield _geometry(body.shape), _transform(arm.T_world_base @ T)


def between(arms, made, joints):
    """The smallest distance of any part of one arm from any part of the other [m]."""
    first, second = (list(parts(made[name], arms.placements[name], joints[name])) for name in arms.placements)
    request, result = hppfcl.DistanceRequest(), hppfcl.DistanceResult()
    return min(hppfcl.distance(*one, *other, request, result) for one in first for other in second)


@settings(max_examples=30)
@given(standing(0.35, 40.0), st.lists(st.floats(-1.0, 1.0), min_size=14, max_size=14), st.sampled_from(OPENINGS))
def test_where_each_guard_lets_its_arm_be_the_arms_are_apart(sides, parts, opening):
    arms = arms_from(sides)
    made = guards(arms, opening)
    joints = {name: np.array(part) * FREE.model.upper for name, part in zip(arms.placements, (parts[:7], parts[7:]))}
    assume(all(made[name].fault_at(q) is None for name, q in joints.items()))
    assert between(arms, made, joints) >= APART_M - NOISE_M


reaches = st.tuples(st.floats(-0.15, 0.05), st.floats(0.25, 0.5), st.floats(-0.1, 0.1))


@settings(max_examples=4, deadline=None)
@example(TWO, [(-0.05, 0.45, 0.0)], [(-0.05, 0.45, 0.0)], OPENINGS[0])
@given(
    standing(0.45, 15.0),
    st.lists(reaches, min_size=1, max_size=2),
    st.lists(reaches, min_size=1, max_size=2),
    st.sampled_from(OPENINGS),
)
def test_two_arms_whose_hands_reach_for_each_other_never_come_nearer(sides, left, right, opening):
    """Without a workspace: each hand goes as far over to the other side as it likes, at 0.5 m/s, and back."""
    arms = arms_from(sides)
    made, limits = guards(arms, opening), {}
    for name, guard in made.items():
        assume(guard.fault_at(HOME.q) is None)
        limits[name] = assembly.motion_limits(LIFTED, FREE, guard)
        limits[name].reset(HOME.q)
    ways = {"left": reaching(left, -1.0), "right": reaching(right, 1.0)}
    cycles = max(map(len, ways.values()))
    watch, least = guards(arms, opening), np.inf
    for cycle in range(cycles + 300):
        for name, way in ways.items():
            limits[name].step(way[min(cycle, len(way) - 1)], limits[name].goal, DT)
        if cycle % 8 == 0:
            least = min(least, between(arms, watch, {name: one.goal for name, one in limits.items()}))
    assert least >= APART_M - NOISE_M
    for one in limits.values():
        np.testing.assert_allclose(one.goal, HOME.q, atol=2e-3, err_msg="the way back is taken")


def reaching(waypoints, sign):
    """Joint targets of a tool that goes to waypoints relative to home [m], y towards the other arm, and back."""
    targets, q, T_home = [], HOME.q, KINEMATICS.forward(HOME.q)
    points = [np.zeros(3), *(np.array((x, sign * y, z)) for x, y, z in waypoints), np.zeros(3)]
    for a, b in zip(points, points[1:]):
        steps = max(round(float(np.linalg.norm(b - a)) / 0.25 / DT), 10)
        for s in (np.arange(steps) + 1.0) / steps:
            s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
            found = KINEMATICS.inverse(pose(p=a + s * (b - a)) @ T_home, q_seed=q, keep_branch=True).q
            q = q if found is None else found
            targets.append(q)
    return targets


def test_the_file_says_whether_the_places_were_measured_in_simulation():
    two = {name: TWO[name] for name in ("margin", "left", "right")}
    assert [arms_from({**two, **said}).simulated for said in ({}, {"simulated": True}, {"simulated": False})] == [
        None, True, False,
    ]  # fmt: skip


def test_the_wall_stands_halfway_and_is_the_same_for_both():
    arms = arms_from(TWO)
    for name, sign in (("left", -1.0), ("right", 1.0)):
        (wall,) = walls(arms, name)
        assert wall.name == f"side of {'right' if name == 'left' else 'left'}" and wall.shape.size[0] == WALL_M
        T_world_wall = arms.placements[name].T_world_base @ wall.T_link_body
        np.testing.assert_allclose(T_world_wall[:3, 3], 0.0, atol=1e-12)
        np.testing.assert_allclose(T_world_wall[:3, 0], [0.0, sign, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "values, words",
    [
        ([], "must be a mapping"),
        ({**TWO, "margin": 0.29}, r"arms/margin is 0.29, but must be a finite number in \[0.3, 5\] m"),
        ({**TWO, "margin": float("nan")}, "arms/margin is nan"),
        ({"left": TWO["left"], "right": TWO["right"]}, "arms/margin is None"),
        ({"margin": 0.3, "left": TWO["left"]}, "names 1 arms, but must name at least two"),
        ({**TWO, "left": 1}, "arms/left/ is 1"),
        ({**TWO, "left": {"position": [0, 11, 0]}}, "arms/left/position is"),
        ({**TWO, "left": {"rpy": [0, 0, 0]}}, "arms/left/position is missing"),
        ({**TWO, "the left": TWO["left"]}, "arms/the left: an arm's name"),
        ({**TWO, 3: TWO["left"]}, "arms/3: an arm's name"),
        ({**TWO, "simulated": "no"}, "arms/simulated is 'no', but must be true or false"),
    ],
)
def test_bad_values_are_refused_by_their_key(values, words):
    with pytest.raises(ConfigError, match=words):
        arms_from(values, "arms/")

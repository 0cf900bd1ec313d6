"""Arms in one world: their workspaces keep the margin, by the nearest points of the filled workspaces."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from test_workspace import SETTINGS, beyond, workspaces

from common.arms import arms_from
from common.config import parse
from common.errors import ConfigError
from common.poses import inverse, pose
from common.rotations import rotation_from_zyx
from kuka_control.model.arms import filled, nearest_points, placement_faults
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.rig import workspace_of
from kuka_control.model.workspace import Workspace

CONFIG = Path(__file__).parents[1] / "config"
TWO = yaml.safe_load((CONFIG / "two_arms.yaml").read_text())
AHEAD = Workspace(**{**SETTINGS, "center_line": np.array([1.0, 0.0, 0.0])})
UPRIGHT = np.zeros(3)


def shipped():
    names = "kuka_params_rt.yaml", "arm_of_two.yaml"
    values = {key: value for name in names for key, value in yaml.safe_load((CONFIG / name).read_text()).items()}
    return workspace_of(parse(RealTimeConfig, values))


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


@pytest.mark.parametrize(
    "T, distance",
    [
        (pose(rotation_from_zyx(np.pi, 0.0, 0.0), [2.0, 0.0, 0.0]), 0.6),  # face to face, at the height of joint 2
        (pose(p=[0.0, 0.9, 0.0]), 0.9 - 2 * 0.7 * np.sin(np.radians(25.0))),  # side by side
        (pose(p=[0.0, 0.0, 1.0]), 0.6),  # one above the other: between the z limits
        (pose(p=[0.0, 0.1, 0.0]), 0.0),
    ],
)
def test_examples(T, distance):
    assert nearest_points(filled(AHEAD, np.eye(4)), filled(AHEAD, T)).distance == pytest.approx(distance, abs=2e-6)


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
    ],
)
def test_bad_values_are_refused_by_their_key(values, words):
    with pytest.raises(ConfigError, match=words):
        arms_from(values, "arms/")

"""Laws of the tool's pose for a grasp."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from common.poses import check_pose, inverse, pose
from common.rotations import rotation_about, rotation_angle, rotation_from_zyx
from grasping.pipeline.tool_pose import (
    LimitsConfig,
    ToolPoseConfig,
    above,
    taken,
    tool_pose,
    wait_rejection_reason,
)

YAML = yaml.safe_load((Path(__file__).parents[1] / "config" / "tool_pose.yaml").read_text())
DOWN = rotation_about(0, np.pi)
angles = st.floats(-np.pi, np.pi)
tilts = st.floats(-1.2, 1.2)
places = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
grasps = st.builds(
    lambda a, b, c, p: pose(DOWN @ rotation_from_zyx(a, b, c), p), angles, tilts, tilts, places
)  # from above, tilted
orientations = st.builds(rotation_from_zyx, angles, tilts, angles)


def settings(**changes) -> ToolPoseConfig:
    return parse(ToolPoseConfig, {**YAML, **changes})


@given(grasps, orientations, angles, st.sampled_from(["vertical", "grasp"]))
def test_the_grip_is_at_the_grasp_and_the_fingers_close_along_it(T_base_grasp, near, closing, approach):
    s = settings(closing_angle=np.degrees(closing), approach=approach)
    T = check_pose(tool_pose(T_base_grasp, s, near))
    np.testing.assert_allclose(T @ [*s.grip_in_tool, 1.0], T_base_grasp[:, 3], atol=1e-9)
    fingers = T[:3, :3] @ rotation_about(2, closing)[:, 0]
    z = T_base_grasp[:3, 2] if approach == "grasp" else np.array([0.0, 0.0, -1.0])
    np.testing.assert_allclose(T[:3, 2], z, atol=1e-9)
    across = T_base_grasp[:3, 0] - (T_base_grasp[:3, 0] @ z) * z
    np.testing.assert_allclose(abs(fingers @ across), np.linalg.norm(across), atol=1e-9)


@given(grasps, orientations)
def test_of_both_orientations_it_is_the_nearer(T_base_grasp, near):
    R = tool_pose(T_base_grasp, settings(), near)[:3, :3]
    other = R @ rotation_about(2, np.pi)
    assert rotation_angle(near.T @ R) <= rotation_angle(near.T @ other) + 1e-9


@given(grasps, orientations)
def test_a_grasp_and_the_same_turned_by_half_a_turn_are_one(T_base_grasp, near):
    first = tool_pose(T_base_grasp, settings(), near)
    again = tool_pose(T_base_grasp @ pose(rotation_about(2, np.pi)), settings(), near)
    turns = [rotation_angle(near.T @ T[:3, :3]) for T in (first, again)]
    np.testing.assert_allclose(turns[0], turns[1], atol=1e-6)
    if turns[0] < np.pi / 2 - 1e-3:  # else both orientations may be equally far away
        np.testing.assert_allclose(first, again, atol=1e-9)


@given(grasps, orientations, st.floats(0.0, 0.5))
def test_above_is_against_the_approach(T_base_grasp, near, clearance):
    T = tool_pose(T_base_grasp, settings(), near)
    lifted = above(T, clearance)
    np.testing.assert_allclose(inverse(T) @ lifted, pose(p=(0.0, 0.0, -clearance)), atol=1e-9)
    np.testing.assert_allclose(lifted[:3, 3] - T[:3, 3], (0.0, 0.0, clearance), atol=1e-9)


@given(grasps, orientations, st.floats(0.01, 0.5))
def test_for_a_grasp_with_an_approach_of_its_own_the_tool_waits_on_the_approachs_line(T_base_grasp, near, clearance):
    T = tool_pose(T_base_grasp, taken(settings(approach="vertical"), True), near)
    before = above(T, clearance) @ [*settings().grip_in_tool, 1.0]
    np.testing.assert_allclose(before[:3], T_base_grasp[:3, 3] - clearance * T_base_grasp[:3, 2], atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], T_base_grasp[:3, 2], atol=1e-9)
    assert taken(settings(), False).approach == settings().approach == "vertical"


def test_a_grasp_from_above_is_taken_alike_with_and_without_an_approach_of_its_own():
    T_base_grasp = pose(DOWN @ rotation_about(2, 0.4), (0.5, 0.1, 0.05))
    own, usual = (tool_pose(T_base_grasp, taken(settings(), own), DOWN) for own in (True, False))
    np.testing.assert_allclose(own, usual, atol=1e-9)


LIMITS = parse(LimitsConfig, {"nearest": 0.3, "farthest": 2.0, "x": [-1.0, 1.0], "y": [-1.0, 1.0], "z": [-0.2, 0.3]})


@pytest.mark.parametrize(
    ("tilt", "x", "clearance", "why"),
    [
        (0.7, 0.5, 0.12, ""),
        (0.7, 0.95, 0.12, "where the hand would wait for it, its x is 1.03 m in the base frame"),
        (0.0, 0.5, 0.25, "where the hand would wait for it, its z is 0.35 m in the base frame"),
        (1.7, 0.5, 0.12, "the hand would wait lower than it"),
        (1.7, 0.5, 0.0, ""),
    ],
)
def test_where_the_hand_cannot_wait_there_is_no_grasp(tilt, x, clearance, why):
    T_base_grasp = pose(DOWN @ rotation_about(1, -tilt), (x, 0.0, 0.1))
    found = wait_rejection_reason(T_base_grasp, clearance, np.array([0.0, 0.0, 1.0]), LIMITS)
    assert found.startswith(why) and bool(found) == bool(why), found


def test_on_a_wall_the_tool_points_along_the_worlds_vertical():
    up = np.array([-1.0, 0.0, 0.0])
    T = tool_pose(pose(rotation_about(1, np.pi / 2)), settings(), np.eye(3), up)
    np.testing.assert_allclose(T[:3, 2], -up, atol=1e-12)

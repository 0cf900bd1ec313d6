"""Laws of the study of what the arm reaches."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.mounting import mounting_frame
from common.poses import translation
from iiwa_kinematics import IkFailure, Kinematics
from iiwa_kinematics.robot_model import robot_model
from kuka_control.model.home_pose import home_pose
from kuka_control.model.workspace import Workspace
from kuka_control.model.workspace_study import study_reach, tool_rotation, volume_samples

MODEL = robot_model("LBR7R800", "MF_elektrisch")
TOOL_M = 0.106
TOOL = translation(0.0, 0.0, TOOL_M)
WIDE = (math.radians(25.0),) * 3
angles = st.floats(-0.5, 0.5)
headings = st.sampled_from([0.0, 0.5, -0.8, 1.5, math.pi / 2, -math.pi / 2, 2.0, math.pi, -2.5])


def workspace(heading=-0.8, high=0.6):
    line = np.round([math.cos(heading), math.sin(heading), 0.0], 12)
    return Workspace(line, math.radians(50.0), 0.2, high, 0.5, 0.7, MODEL.base_shoulder)


def study(tolerances=WIDE, tool=TOOL_M, count=150, seed=0, attitudes=6, space=None):
    space = space or workspace()
    random = np.random.default_rng(seed)
    positions = volume_samples(space, count, random)
    kinematics = Kinematics(MODEL, translation(0.0, 0.0, tool))
    q_home = home_pose(Kinematics(MODEL, TOOL), space).q
    mounting = mounting_frame(space.center_line)
    return study_reach(kinematics, mounting, q_home, positions, tolerances, attitudes, random)


@given(headings)
def test_at_zero_the_tool_has_the_attitude_of_the_home_position(heading):
    space = workspace(heading)
    R_home = home_pose(Kinematics(MODEL, TOOL), space).T_base_tool[:3, :3]
    np.testing.assert_allclose(tool_rotation(mounting_frame(space.center_line), 0.0, 0.0, 0.0), R_home, atol=1e-9)


@given(headings, angles, angles, angles)
def test_the_tool_is_turned_by_yaw_about_the_vertical_and_tilted_by_pitch_and_roll(heading, yaw, pitch, roll):
    space = workspace(heading)
    R = tool_rotation(mounting_frame(space.center_line), yaw, pitch, roll)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert R[2, 2] == pytest.approx(-math.cos(pitch) * math.cos(roll), abs=1e-12)
    forward = R[:, 0] if space.center_line[0] < 0.0 else -R[:, 0]
    assert math.sin(pitch) == pytest.approx(forward[2], abs=1e-12)
    left = math.atan2(forward[1], forward[0]) - space.heading
    assert math.remainder(left + yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_the_positions_too_far_are_those_whose_wrist_the_outstretched_arm_does_not_reach():
    found = study(count=600)
    wrist = found.positions + np.array([0.0, 0.0, TOOL_M + MODEL.wrist_flange - MODEL.base_shoulder])
    beyond = np.linalg.norm(wrist, axis=1) > MODEL.shoulder_elbow + MODEL.elbow_wrist
    assert found.failures[IkFailure.TOO_FAR] == beyond.sum() > 0
    assert not np.any(found.down & beyond)
    assert sum(found.failures.values()) == np.sum(~found.down)
    assert found.percent_down == pytest.approx(100.0 * found.down.mean())


def test_a_low_workspace_is_reached_everywhere_and_with_a_long_tool_nowhere():
    low = workspace(high=0.35)
    assert study(space=low).percent_down == 100.0
    beyond = study(space=low, tool=2.0)
    assert beyond.percent_down == beyond.percent_within == beyond.percent_always == 0.0


@settings(max_examples=5)
@given(st.integers(0, 100))
def test_percentages_are_in_order(seed):
    found = study(seed=seed, count=60)
    assert 0.0 <= found.percent_always <= min(found.percent_down, found.percent_within) <= 100.0


@pytest.mark.parametrize(("count", "attitudes"), [(0, 5), (5, 0)])
def test_nothing_to_study_is_refused(count, attitudes):
    space = workspace()
    with pytest.raises(ValueError, match="a study needs"):
        study_reach(
            Kinematics(MODEL),
            mounting_frame(space.center_line),
            np.zeros(7),
            np.zeros((count, 3)),
            WIDE,
            attitudes,
            np.random.default_rng(),
        )

"""The home position: for every direction of center_line, arm and tool, against forward kinematics."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.mounting import mounting_frame
from common.poses import pose, translation
from common.rotations import rotation_about, rotation_from_zyx
from iiwa_kinematics import Kinematics, forward
from iiwa_kinematics.robot_model import robot_model
from kuka_control.model.home_pose import HomeError, custom_home, home_pose
from kuka_control.model.workspace import Workspace

MODELS = [robot_model("LBR7R800", "MF_elektrisch"), robot_model("LBR14R820", "MF_touch_pneumatisch")]
TOOL_LENGTH = 0.106
TOOL = translation(0.0, 0.0, TOOL_LENGTH)
CUSTOM = np.radians([-45.0, 30.0, 0.0, -80.0, 0.0, 70.0, 0.0])


def workspace_of(model, center_line, **changes):
    settings = {"z_lower": 0.2, "z_upper": 0.6, "inner_sphere": 0.5, "outer_sphere": 0.7, **changes}
    return Workspace(
        center_line=np.array(center_line),
        opening_angle=math.radians(50.0),
        joint_2_height=model.base_shoulder,
        **settings,
    )


def check(home, model, workspace, tool_length):
    """What holds for every home position that is calculated."""
    x, y, _ = workspace.center_line
    heading = math.atan2(y, x)
    # Tool z down; tool x back to the base for center_line.x >= 0, else along center_line.
    if x >= 0.0:
        R = rotation_about(2, heading) @ rotation_about(1, math.pi)
    else:
        R = rotation_about(2, heading) @ rotation_about(0, math.pi)
    T_base_tool = pose(R, workspace.centre)
    np.testing.assert_allclose(home.T_base_tool, T_base_tool, atol=1e-9)
    np.testing.assert_allclose(forward(model, home.q) @ translation(0.0, 0.0, tool_length), T_base_tool, atol=1e-9)
    np.testing.assert_allclose(home.T_base_flange @ translation(0.0, 0.0, tool_length), T_base_tool, atol=1e-9)
    np.testing.assert_array_equal(home.centre, workspace.centre)
    assert np.all(model.lower <= home.q) and np.all(home.q <= model.upper)
    np.testing.assert_array_equal(home.q[[2, 4, 6]], 0.0)
    assert abs(home.q[0]) <= math.pi / 2 + 1e-9
    elbow = model.base_shoulder + model.shoulder_elbow * math.cos(home.q[1])
    wrist = workspace.centre[2] + tool_length + model.wrist_flange
    share = model.shoulder_elbow / (model.shoulder_elbow + model.elbow_wrist)
    assert elbow > model.base_shoulder + share * (wrist - model.base_shoulder), "the elbow is up"


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
@given(heading=st.floats(-math.pi, math.pi), tool_length=st.floats(0.0, 0.2), size=st.floats(0.01, 100.0))
def test_every_direction_and_tool(model, heading, tool_length, size):
    workspace = workspace_of(model, [size * math.cos(heading), size * math.sin(heading), 0.0])
    home = home_pose(Kinematics(model, translation(0.0, 0.0, tool_length)), workspace)
    check(home, model, workspace, tool_length)
    sign = 1.0 if workspace.center_line[0] >= 0.0 else -1.0
    assert np.array_equal(np.sign(home.q[[1, 3, 5]]), [sign, -sign, sign])


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
@pytest.mark.parametrize(
    "center_line, joint_1, signs",
    [
        ([1, 0, 0], 0.0, (1, -1, 1)),
        ([1, -1, 0], -45.0, (1, -1, 1)),
        ([1, 1, 0], 45.0, (1, -1, 1)),
        ([0, 1, 0], 90.0, (1, -1, 1)),
        ([0, -1, 0], -90.0, (1, -1, 1)),
        ([-1, 0, 0], 0.0, (-1, 1, -1)),
        ([-1, 1, 0], -45.0, (-1, 1, -1)),
        ([-1, -1, 0], 45.0, (-1, 1, -1)),
        ([-1e-9, 1, 0], -90.0, (-1, 1, -1)),
    ],
)
def test_which_way_joint_1_turns_and_the_arm_leans(model, center_line, joint_1, signs):
    workspace = workspace_of(model, np.array(center_line, dtype=float))
    home = home_pose(Kinematics(model, TOOL), workspace)
    check(home, model, workspace, TOOL_LENGTH)
    assert math.degrees(home.q[0]) == pytest.approx(joint_1, abs=1e-6)
    assert tuple(np.sign(home.q[[1, 3, 5]])) == signs


def test_joint_out_of_range_is_named():
    """High and with a long tool the forearm points so far up that joint 6 cannot turn the tool down."""
    model = MODELS[0]
    high = workspace_of(model, [1.0, 0.0, 0.0], z_lower=0.55)
    with pytest.raises(
        HomeError, match=r"needs joint 6 at 12\d\.\d deg \(range -120 to 120 deg\); probably the tool is"
    ):
        home_pose(Kinematics(model, translation(0.0, 0.0, 0.16)), high)


def test_settings_that_can_be_reached_lead_home_and_others_are_refused():
    """Over all settings a home position is right, or refused."""
    rng = np.random.default_rng(1)
    model, found, refused = MODELS[0], 0, 0
    for _ in range(500):
        inner = rng.uniform(0.4, 0.75)
        z_lower = rng.uniform(0.1, 0.7)
        workspace = workspace_of(
            model,
            [rng.normal(), rng.normal(), 0.0],
            inner_sphere=inner,
            outer_sphere=rng.uniform(inner + 0.01, 0.8),
            z_lower=z_lower,
            z_upper=rng.uniform(z_lower + 0.01, 0.75),
        )
        tool_length = rng.uniform(0.0, 0.4)
        try:
            home = home_pose(Kinematics(model, translation(0.0, 0.0, tool_length)), workspace)
        except HomeError:
            refused += 1
            continue
        check(home, model, workspace, tool_length)
        found += 1
    assert found > 50 and refused > 50


def test_custom_home_is_where_its_joints_bring_the_tool():
    model = MODELS[0]
    workspace = workspace_of(model, [1.0, -1.0, 0.0])
    q = CUSTOM + np.radians([5.0, 5.0, 0.0, 5.0, 3.0, 0.0, 10.0])
    home = custom_home(Kinematics(model, TOOL), workspace, q)
    np.testing.assert_array_equal(home.q, q)
    np.testing.assert_allclose(home.T_base_flange, forward(model, q), atol=1e-15)
    np.testing.assert_allclose(home.T_base_tool, home.T_base_flange @ translation(0.0, 0.0, TOOL_LENGTH), atol=1e-12)
    np.testing.assert_array_equal(home.centre, home.T_base_tool[:3, 3])


@pytest.mark.parametrize(
    "q, words",
    [
        (CUSTOM + np.radians([100.0, 0, 0, 0, 0, 0, 0]), r"out of the workspace: .* behind the base"),
        (CUSTOM + np.radians([40.0, 0, 0, 0, 0, 0, 0]), r"outside the workspace \(opening angle.*\)"),
        (np.radians([-45.0, 0, 0, 0, 0, 0, 0]), r"home_pos .* workspace"),
        (np.radians([0, 0, 0, -121.0, 0, 0, 176.0]), r"joint 4 at -121.0 deg \(range -120 .* and joint 7 at 176"),
        (np.full(7, np.nan), "seven finite numbers"),
        (np.zeros(6), "seven finite numbers"),
    ],
)
def test_custom_home_that_cannot_be_is_refused(q, words):
    model = MODELS[0]
    with pytest.raises(HomeError, match=words):
        custom_home(Kinematics(model, TOOL), workspace_of(model, [1.0, -1.0, 0.0]), q)


degrees = st.floats(-180.0, 180.0)
headings = st.floats(-math.pi, math.pi)


def check_any(home, model, workspace, T_flange_tool, mounting):
    """What holds for every home position that is calculated, with any tool on any arm."""
    T_base_tool = pose(mounting.R_base_tool, workspace.centre)
    np.testing.assert_allclose(home.T_base_tool, T_base_tool, atol=1e-9)
    np.testing.assert_allclose(forward(model, home.q) @ T_flange_tool, T_base_tool, atol=1e-9)
    np.testing.assert_allclose(home.T_base_flange @ T_flange_tool, T_base_tool, atol=1e-9)
    assert np.all(model.lower <= home.q) and np.all(home.q <= model.upper)
    assert home.q[2] == 0.0


def roomy(model, heading, rng):
    inner, z_lower = rng.uniform(0.45, 0.7), rng.uniform(0.15, 0.65)
    return workspace_of(
        model,
        [math.cos(heading), math.sin(heading), 0.0],
        z_lower=z_lower,
        z_upper=z_lower + 0.2,
        inner_sphere=inner,
        outer_sphere=inner + 0.08,
    )


def test_any_tool_on_any_arm_has_the_pose_of_the_law_at_home_or_is_refused():
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(600):
        model = MODELS[rng.integers(2)]
        workspace = roomy(model, rng.uniform(-math.pi, math.pi), rng)
        T = pose(rotation_from_zyx(*rng.uniform(-math.pi, math.pi, 3)), rng.uniform(-0.15, 0.15, 3))
        mounting = mounting_frame(workspace.center_line, rng.uniform(-180.0, 180.0, 3))
        try:
            home = home_pose(Kinematics(model, T), workspace, mounting)
        except HomeError as error:
            assert re.search("out of reach|needs joint", str(error))
            continue
        check_any(home, model, workspace, T, mounting)
        found += 1
    assert found > 50


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
@given(headings, st.floats(-1.0, 1.0), st.floats(-0.05, 0.05), st.floats(0.0, 0.1))
def test_a_tool_within_the_arms_plane_leaves_joints_3_5_and_7_at_zero(model, heading, pitch, x, z):
    workspace = workspace_of(model, [math.cos(heading), math.sin(heading), 0.0])
    T = pose(rotation_about(1, pitch), (x, 0.0, z))
    try:
        home = home_pose(Kinematics(model, T), workspace)
    except HomeError as error:
        assert re.search("joint [46]|out of reach", str(error)), error
        return
    check_any(home, model, workspace, T, mounting_frame(workspace.center_line))
    np.testing.assert_allclose(home.q[[2, 4, 6]], 0.0, atol=1e-7)


@given(headings, st.floats(-2.9, 2.9), st.floats(0.0, 0.12))
def test_a_tool_turned_about_the_flanges_axis_turns_joint_7_alone(heading, turn, length):
    model = MODELS[0]
    workspace = workspace_of(model, [math.cos(heading), math.sin(heading), 0.0])
    plain = home_pose(Kinematics(model, translation(0.0, 0.0, length)), workspace)
    home = home_pose(Kinematics(model, pose(rotation_about(2, turn), (0.0, 0.0, length))), workspace)
    check_any(
        home, model, workspace, pose(rotation_about(2, turn), (0, 0, length)), mounting_frame(workspace.center_line)
    )
    np.testing.assert_allclose(home.q - plain.q, [0, 0, 0, 0, 0, 0, -turn], atol=1e-9)


def test_a_tool_whose_x_axis_points_back_along_the_flange_is_refused_with_the_cause():
    turned = pose(rotation_about(2, math.pi), (0, 0, 0.1))
    with pytest.raises(
        HomeError, match=r"needs joint [57] at -?180.0 deg .*; probably tool_transform turns the tool too"
    ):
        home_pose(Kinematics(MODELS[0], turned), workspace_of(MODELS[0], [1.0, -1.0, 0.0]))


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
@given(heading=headings, yaw=degrees)
def test_on_a_ceiling_the_tool_points_away_from_the_base(model, heading, yaw):
    workspace = workspace_of(
        model,
        [math.cos(heading), math.sin(heading), 0.0],
        z_lower=0.7,
        z_upper=1.1,
        inner_sphere=0.6,
        outer_sphere=0.79,
    )
    mounting = mounting_frame(workspace.center_line, (180.0, 0.0, yaw))
    home = home_pose(Kinematics(model, TOOL), workspace, mounting)
    check_any(home, model, workspace, TOOL, mounting)
    np.testing.assert_allclose(home.T_base_tool[:3, 2], [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(home.q[[2, 4, 6]], 0.0, atol=1e-9)
    assert abs(home.q[0]) <= math.pi / 2 + 1e-9


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
@pytest.mark.parametrize(("angles", "line"), [((0, 90, 0), [1, 0, 0]), ((90, 0, 0), [0, -1, 0])])
def test_on_a_wall_a_centre_line_that_points_down_keeps_the_arm_in_its_plane(model, angles, line):
    line = np.array(line, dtype=float)
    workspace = workspace_of(model, line, z_lower=0.4, z_upper=0.8, inner_sphere=0.65, outer_sphere=0.79)
    mounting = mounting_frame(line, angles)
    home = home_pose(Kinematics(model, TOOL), workspace, mounting)
    check_any(home, model, workspace, TOOL, mounting)
    np.testing.assert_allclose(home.T_base_tool[:3, 2], line, atol=1e-9)
    np.testing.assert_allclose(home.q[[2, 4, 6]], 0.0, atol=1e-9)
    with pytest.raises(HomeError, match="out of reach: .* on a wall with center_line down or sideways"):
        home_pose(Kinematics(model, TOOL), workspace, mounting_frame(line, [-angle for angle in angles]))


def test_joint_1_stays_in_its_quarter_where_the_wrist_is_behind_the_base_axis():
    model = MODELS[0]
    workspace = workspace_of(model, [1.0, 0.1, 0.0], z_lower=0.9, z_upper=1.1, inner_sphere=0.6, outer_sphere=0.79)
    mounting = mounting_frame([1.0, 0.1, 0.0], (0.0, 90.0, 0.0))
    home = home_pose(Kinematics(model, TOOL), workspace, mounting)
    check_any(home, model, workspace, TOOL, mounting)
    wrist = home.T_base_flange[:3, 3] - model.wrist_flange * home.T_base_flange[:3, 2]
    assert wrist[0] < 0.0 and abs(home.q[0]) < math.pi / 2

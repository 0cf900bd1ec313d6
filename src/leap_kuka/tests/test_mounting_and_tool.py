"""Arms on ceilings and walls, and tools that are a whole pose: what the operator's hand asks for."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import ConfigError
from common.mounting import mounting_frame, rotation_of_mounting
from common.poses import pose
from common.rotations import rotation_from_zyx
from leap_kuka.teleop import ArmTeleop, StreamState

degrees = st.floats(-180.0, 180.0)
mountings = st.tuples(degrees, degrees, degrees)
lines = st.floats(-math.pi, math.pi).map(lambda a: (math.cos(a), math.sin(a), 0.0))
BOX_HEIGHT = 0.35


def teleop_of(leap, arm, line, mounting, **changes):
    c = 0.5 * np.array(line)
    settings = {"center_line": line, "ws_center": [c[0], c[1], 0.4], "z_upper_limit": 0.6, "mounting": list(mounting)}
    return ArmTeleop(leap(), arm(**{**settings, **changes}))


@given(lines, mountings, st.floats(-60.0, 60.0))
def test_a_level_straight_hand_asks_for_the_home_tool_at_the_centre(leap, arm, player, sample, line, mounting, yaw):
    """Whatever the mounting, and wherever the hand pointed when the stream began."""
    teleop = teleop_of(leap, arm, line, mounting)
    result = player(teleop).steps(12, sample(yaw=yaw))[-1]
    assert result.state == StreamState.RUNNING, result.reason
    T = result.T_base_virtual @ result.T_virtual_tool
    np.testing.assert_allclose(T[:3, :3], mounting_frame(line, mounting).R_base_tool, atol=1e-7)
    np.testing.assert_allclose(T[:3, 3], [0.5 * line[0], 0.5 * line[1], 0.4], atol=1e-7)


@given(lines, mountings, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_the_tool_moves_in_the_world_as_the_hand_does(leap, arm, player, sample, line, mounting, right, up, back):
    teleop = teleop_of(leap, arm, line, mounting)
    frames = player(teleop)
    frames.steps(12, sample())
    result = frames.steps(30, sample(position=(right, BOX_HEIGHT + up, back)))[-1]
    moved = (result.T_base_virtual @ result.T_virtual_tool)[:3, 3] - [0.5 * line[0], 0.5 * line[1], 0.4]
    assert (rotation_of_mounting(mounting) @ moved)[2] == pytest.approx(up, abs=1e-7)
    assert moved @ mounting_frame(line, mounting).forward == pytest.approx(-back, abs=1e-7)
    assert np.linalg.norm(moved) == pytest.approx(math.hypot(right, up, back), abs=1e-7)


def test_on_a_ceiling_the_box_stands_over_the_leap_by_the_depth_below_the_centre(leap, arm):
    teleop = teleop_of(leap, arm, (1, 0, 0), (180, 0, 0), ws_center=[0.5, 0.0, 0.5])
    np.testing.assert_allclose(teleop.box.center, [0.0, 0.6 - 0.5 + 0.15, 0.0])
    upright = teleop_of(leap, arm, (1, 0, 0), (0, 0, 0), ws_center=[0.5, 0.0, 0.5])
    np.testing.assert_allclose(upright.box.center, [0.0, 0.5 - 0.2 + 0.15, 0.0])


def test_an_arm_that_hangs_needs_to_know_its_upper_limit(leap, arm):
    with pytest.raises(ConfigError, match="z_upper_limit is missing"):
        arm(mounting=[180, 0, 0])
    with pytest.raises(ConfigError, match="must be below z_upper_limit"):
        arm(mounting=[180, 0, 0], z_upper_limit=0.3)
    arm(mounting=[0, 0, 30])


@given(*[st.floats(-3.0, 3.0)] * 3, *[st.floats(-0.3, 0.3)] * 3)
def test_the_desired_flange_carries_the_tool(leap, arm, a, b, c, x, y, z):
    T = pose(rotation_from_zyx(a, b, c), (x, y, z))
    teleop = ArmTeleop(leap(), arm(use_tool_transform=True, tool_transform=T.ravel().tolist()))
    np.testing.assert_allclose(teleop.T_tool_flange @ T, np.eye(4), atol=1e-12)


def test_a_tool_that_mirrors_is_refused(arm):
    with pytest.raises(ConfigError, match="kuka/tool_transform"):
        arm(use_tool_transform=True, tool_transform=np.diag([1.0, 1.0, -1.0, 1.0]).ravel().tolist())

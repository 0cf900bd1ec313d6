"""Arms on ceilings and walls, and tools that are a whole pose: what the operator's hand asks for."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import ConfigError
from common.mounting import mounting_frame, rotation_of_mounting
from common.poses import pose
from common.rotations import quaternion_from_rotation, rotation_about, rotation_from_quaternion, rotation_from_zyx
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import StreamState

degrees = st.floats(-180.0, 180.0)
mountings = st.tuples(degrees, degrees, degrees)
lines = st.floats(-math.pi, math.pi).map(lambda a: (math.cos(a), math.sin(a), 0.0))
quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.1)
turns = quaternions.map(lambda q: tuple(x / math.hypot(*q) for x in q))
tilts = st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)).map(
    lambda a: quaternion_from_rotation(rotation_from_zyx(0.0, a[0], a[1]) @ np.diag([-1.0, 1.0, -1.0])).tolist()
)
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


@given(lines, mountings, turns, st.floats(-60.0, 60.0))
def test_a_level_straight_hand_asks_for_the_rotation_of_a_home_of_ones_own(
    leap, arm, player, sample, line, mounting, q_home, yaw
):
    teleop = teleop_of(leap, arm, line, mounting, use_home_pos=True, rotation_home=list(q_home))
    result = player(teleop).steps(12, sample(yaw=yaw))[-1]
    T = result.T_base_virtual @ result.T_virtual_tool
    np.testing.assert_allclose(T[:3, :3], rotation_from_quaternion(q_home), atol=1e-7)
    np.testing.assert_allclose(result.T_base_virtual[:3, 1], mounting_frame(line, mounting).up, atol=1e-7)


@given(lines, turns, st.floats(-24.0, 24.0), st.floats(-19.0, 19.0), st.floats(-19.0, 19.0))
def test_a_tool_that_is_tilted_at_home_turns_in_the_world_as_the_hand_does(
    leap, arm, player, sample, line, q_home, yaw, pitch, roll
):
    def turned(**changes):
        frames = player(teleop_of(leap, arm, line, (0, 0, 0), **changes))
        R = [frames.steps(30, hand)[-1] for hand in (sample(), sample(yaw, pitch, roll))]
        start, end = ((result.T_base_virtual @ result.T_virtual_tool)[:3, :3] for result in R)
        return end @ start.T

    plain = turned()
    tilted = turned(use_home_pos=True, rotation_home=list(q_home))
    np.testing.assert_allclose(tilted, plain, atol=1e-7)


@given(lines, mountings)
def test_a_home_of_ones_own_that_points_down_changes_nothing(leap, arm, player, sample, line, mounting):
    q_home = quaternion_from_rotation(mounting_frame(line, mounting).R_base_tool).tolist()
    plain, own = (
        player(teleop_of(leap, arm, line, mounting, **changes)).steps(12, sample(20.0, 5.0, -5.0))[-1]
        for changes in ({}, {"use_home_pos": True, "rotation_home": q_home})
    )
    np.testing.assert_allclose(own.T_virtual_tool, plain.T_virtual_tool, atol=1e-7)
    unused = player(teleop_of(leap, arm, line, mounting, rotation_home=[1.0, 0.0, 0.0, 0.0])).steps(
        12, sample(20.0, 5.0, -5.0)
    )[-1]
    assert unused.T_virtual_tool.tobytes() == plain.T_virtual_tool.tobytes()


@given(lines, tilts, st.floats(-3.1, 3.1), st.floats(-60.0, 60.0))
def test_a_held_tool_is_taken_over_where_it_is_and_the_leap_stays_upright(
    leap, arm, player, sample, line, q_home, turn, yaw
):
    teleop = teleop_of(leap, arm, line, (0, 0, 0), use_home_pos=True, rotation_home=list(q_home))
    frames = player(teleop)
    frames.step()
    teleop.control(False)
    teleop.control(True)
    frames.steps(3, sample(yaw=yaw, position=(0.3, 0.35, 0.0)))
    frames.step()
    T_held = pose(rotation_about(2, turn) @ rotation_from_quaternion(q_home), (0.4 * line[0], 0.4 * line[1], 0.35))
    answer = teleop.hold(T_held, 100.0, frames.now)
    assert answer.success, answer.sentence
    results = frames.steps(12, sample(yaw=yaw))
    running = [result for result in results if result.state == StreamState.RUNNING]
    np.testing.assert_allclose(running[0].T_base_virtual @ running[0].T_virtual_tool, T_held, atol=1e-7)
    np.testing.assert_allclose(running[0].T_base_virtual[:3, 1], [0.0, 0.0, 1.0], atol=1e-7)
    later = frames.steps(200, sample(yaw=yaw))[-1]
    np.testing.assert_allclose(later.T_base_virtual @ later.T_virtual_tool, T_held, atol=1e-7)


def test_a_tool_that_is_not_tilted_as_at_home_is_not_held(leap, arm, player):
    q_home = quaternion_from_rotation(rotation_about(1, 0.9) @ np.diag([-1.0, 1.0, -1.0])).tolist()
    teleop = teleop_of(leap, arm, (1, 0, 0), (0, 0, 0), use_home_pos=True, rotation_home=q_home)
    teleop.control(True)
    frames = player(teleop)
    frames.step()
    answer = teleop.hold(pose(np.diag([-1.0, 1.0, -1.0]), (0.4, 0.1, 0.35)), 100.0, frames.now)
    assert not answer.success and "tilted by 51.6 deg and must be tilted as at home" in answer.sentence


@pytest.mark.parametrize("rotation_home", [None, [0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0]])
def test_a_home_of_ones_own_needs_its_rotation(arm, rotation_home):
    given_ = {} if rotation_home is None else {"rotation_home": rotation_home}
    with pytest.raises(ConfigError, match="kuka/rotation_home"):
        arm(use_home_pos=True, **given_)


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

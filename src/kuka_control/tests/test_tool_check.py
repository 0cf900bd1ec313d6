"""Whether the tool can be brought to a pose: what the check says is what the control loop does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config import parse
from common.poses import pose
from common.rotations import rotation_about, rotation_angle
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.rig import Rig
from kuka_control.model.target import MotionScaling, check_tool_pose, scaled, seed, unscaled
from kuka_control.model.workspace import Infeasible

CONFIG = Path(__file__).parents[1] / "config" / "kuka_params_rt.yaml"
RIG = Rig.of(parse(RealTimeConfig, yaml.safe_load(CONFIG.read_text()), "kuka/"))
HOME = RIG.home
coordinates = st.floats(-0.8, 0.8)
scales = st.floats(0.1, 1.5)


def tool(x=0.0, y=0.0, z=0.0, turn=0.0):
    """The home tool frame, shifted [m] and turned about its z axis [rad]."""
    T = HOME.T_base_tool.copy()
    T[:3, 3] += (x, y, z)
    T[:3, :3] = T[:3, :3] @ rotation_about(2, turn)
    return T


def check(T, scale=1.0):
    return check_tool_pose(RIG.chain, T, MotionScaling(scale), HOME.q)


@given(st.tuples(coordinates, coordinates, coordinates), scales)
def test_scaling_is_undone(position, scale):
    position = np.array(position)
    np.testing.assert_allclose(scaled(unscaled(position, HOME.centre, scale), HOME.centre, scale), position, atol=1e-12)


@settings(max_examples=150)
@given(coordinates, coordinates, st.floats(-0.3, 0.3), st.floats(-1.5, 1.5), scales)
def test_the_answer_is_what_the_control_loop_makes_of_the_desired_frame(x, y, z, turn, scale):
    T = tool(x, y, z, turn)
    answer = check(T, scale)
    target = RIG.chain.resolve(pose(T[:3, :3], unscaled(T[:3, 3], HOME.centre, scale)), MotionScaling(scale), HOME.q)
    if answer.T_base_desired is None:
        assert isinstance(target, Infeasible) or target.bounds or target.failure or target.deviation
    else:
        target = RIG.chain.resolve(answer.T_base_desired, MotionScaling(scale), HOME.q)
        np.testing.assert_allclose(target.T_base_tool, T, atol=1e-9)
        reached = RIG.kinematics.forward(target.q)
        np.testing.assert_allclose(reached[:3, 3], T[:3, 3], atol=1e-9)
        assert rotation_angle(reached[:3, :3].T @ T[:3, :3]) < 1e-6


def test_the_desired_frame_of_half_the_scale_is_twice_as_far_from_the_centre():
    answer = check(tool(0.03, 0.02, 0.05), scale=0.5)
    np.testing.assert_allclose(answer.T_base_desired, tool(0.06, 0.04, 0.1), atol=1e-12)
    assert answer.sentence == "The arm can bring the tool there."


@pytest.mark.parametrize(
    "T, words",
    [
        (tool(z=-0.235), "the lower z limit would move it by 35 mm"),
        (tool(x=0.2, y=-0.2, z=0.3), "the upper z limit and the outer sphere would move it by"),
        (tool(x=-0.8, y=0.8), "infeasible: it lies behind the base"),
        (tool() @ pose(rotation_about(1, np.pi / 2.0)), "The tool pose is out of reach"),
        (
            tool() @ pose(rotation_about(1, np.radians(60.0))),
            "in this position the tool would deviate from it by 36.8 deg.",
        ),
        (tool(x=1e3), "m from the base; is it in metres?"),
        (tool(x=np.nan), "The tool pose is refused: a pose needs 4 x 4 finite numbers"),
        (2.0 * tool(), "The tool pose is refused"),
    ],
)
def test_why_it_cannot_be_brought_there(T, words):
    answer = check(T)
    assert answer.T_base_desired is None
    assert words in answer.sentence and answer.sentence.endswith((".", "?"))


@pytest.mark.parametrize("mode", ["pick_up", "servo", "holding"])
def test_an_arm_that_follows_continues_from_where_it_is(mode):
    joints = HOME.q + 0.1
    assert seed(mode, joints, HOME.q) is joints


@pytest.mark.parametrize("mode", ["starting", "homing", "home", "returning", "zero", "stopped"])
def test_every_other_one_goes_home_first(mode):
    assert seed(mode, np.zeros(7), HOME.q) is HOME.q


def test_before_the_first_reading_it_is_the_home_position():
    assert seed("servo", None, HOME.q) is HOME.q


@settings(max_examples=50)
@given(coordinates, coordinates, st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))
def test_the_obstacle_is_what_keeps_an_arm_that_yields_from_coming(x, y, z, turn):
    T = tool(x, y, z) @ pose(rotation_about(1, turn))
    target = RIG.chain.reach(T, HOME.q)
    expected = str(target) if isinstance(target, Infeasible) else target.failure
    assert check(T).obstacle == expected


@pytest.mark.parametrize("T", [tool(x=1e3), tool(x=np.nan)])
def test_a_refused_tool_pose_is_an_obstacle_too(T):
    assert "the tool pose is refused" in check(T).obstacle


def test_one_check_is_one_inverse_kinematics(monkeypatch):
    asked, reach = [], type(RIG.chain).reach
    monkeypatch.setattr(type(RIG.chain), "reach", lambda *args: asked.append(args) or reach(*args))
    check(tool())
    assert len(asked) == 1

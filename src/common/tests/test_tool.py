"""The tool: a length, or a whole pose that must be rigid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from common.errors import ConfigError
from common.mounting import ToolConfig
from common.poses import pose, translation
from common.rotations import rotation_from_zyx

angle, distance = st.floats(-3.0, 3.0), st.floats(-0.5, 0.5)


def tool(T, **changes):
    values = {"tool_length": 0.106, "tool_transform": np.ravel(T).tolist(), "use_tool_transform": True, **changes}
    return parse(ToolConfig, values, "kuka/").T_flange_tool


@given(st.floats(0.0, 1.0))
def test_a_length_alone_is_a_shift_along_z_bit_for_bit(length):
    np.testing.assert_array_equal(parse(ToolConfig, {"tool_length": length}).T_flange_tool, translation(0, 0, length))
    np.testing.assert_array_equal(
        tool(np.zeros((4, 4)), tool_length=length, use_tool_transform=False), translation(0, 0, length)
    )


@given(angle, angle, angle, distance, distance, distance)
def test_every_rigid_pose_is_taken_as_it_is(a, b, c, x, y, z):
    T = pose(rotation_from_zyx(a, b, c), (x, y, z))
    np.testing.assert_array_equal(tool(T), T)
    np.testing.assert_array_equal(tool(T.round(8)), T.round(8))


@pytest.mark.parametrize(
    "T",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([2.0, 2.0, 2.0, 1.0]),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        np.diag([0.7, 0.7, 1.0, 1.0]),
        translation(0.0, 0.0, 1.0).T,
        translation(0.0, 0.0, 106.0),
        np.full((4, 4), np.nan),
        np.eye(3),
    ],
)
def test_what_is_no_pose_of_a_tool_is_refused_with_one_sentence(T):
    with pytest.raises(ConfigError, match="tool_transform") as error:
        tool(T)
    assert len(error.value.faults) == 1

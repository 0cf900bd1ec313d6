"""Laws of the mounting: which way is up, ahead, and how the tool is turned."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.mounting import STEEP_DEG, mounting_frame, rotation_of_mounting
from common.rotations import check_rotation, rotation_about, zyx_from_rotation

degrees = st.floats(-180.0, 180.0)
mountings = st.tuples(degrees, degrees, degrees)
lines = st.floats(-math.pi, math.pi).map(lambda a: (math.cos(a), math.sin(a), 0.0))


@given(lines, mountings)
def test_the_directions_belong_to_an_upright_world(line, mounting):
    found = mounting_frame(line, mounting)
    R_world_base = rotation_of_mounting(mounting)
    np.testing.assert_allclose(R_world_base @ found.up, [0.0, 0.0, 1.0], atol=1e-12)
    assert (R_world_base @ found.forward)[2] == pytest.approx(0.0, abs=1e-9)
    check_rotation(found.R_base_hand, 1e-9)
    check_rotation(found.R_base_tool, 1e-9)
    np.testing.assert_allclose(found.R_base_tool[:, 2], -found.up, atol=1e-9)


@given(lines, mountings)
def test_ahead_is_the_centre_line_or_away_from_the_wall_as_seen_from_above(line, mounting):
    found = mounting_frame(line, mounting)
    steepness = math.degrees(math.asin(min(1.0, abs(np.dot(line, found.up)))))
    if abs(steepness - STEEP_DEG) < 1e-6:
        return
    seen = np.array([0.0, 0.0, 1.0]) if steepness > STEEP_DEG else np.array(line)
    assert np.cross(found.up, found.forward) @ seen == pytest.approx(0.0, abs=1e-9)
    assert seen @ found.forward > 0.0


@given(lines, degrees)
def test_on_the_floor_nothing_but_the_centre_line_counts(line, yaw):
    found = mounting_frame(line, (0.0, 0.0, yaw))
    np.testing.assert_array_equal(found.up, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(found.forward, line, atol=1e-12)
    assert found.tool_reversed == (line[0] >= 0.0)


@given(lines, mountings, degrees)
def test_turning_the_whole_rig_about_the_vertical_changes_nothing(line, mounting, yaw):
    first, second = mounting_frame(line, mounting), mounting_frame(line, (*mounting[:2], yaw))
    np.testing.assert_allclose(first.R_base_hand, second.R_base_hand, atol=1e-9)


@given(st.floats(-1.5, 1.5), st.floats(-180.0, 180.0))
def test_the_tool_fits_into_the_arms_plane_where_the_vertical_does(angle, tilt):
    """Then joints 3, 5 and 7 can all be zero: the tool's y axis is that of the plane."""
    line = np.array([math.cos(angle), math.sin(angle), 0.0])
    R_world_base = rotation_about(1, math.radians(tilt)) @ rotation_about(2, -angle)
    found = mounting_frame(line, np.degrees(zyx_from_rotation(R_world_base)[::-1]))
    np.testing.assert_allclose(found.R_base_tool[:, 1], [-line[1], line[0], 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("mounting", "line", "up", "ahead", "turned"),
    [
        ((180, 0, 0), (1, 0, 0), (0, 0, -1), (1, 0, 0), False),
        ((0, 180, 0), (1, 0, 0), (0, 0, -1), (1, 0, 0), False),
        ((180, 0, 0), (-1, 0, 0), (0, 0, -1), (-1, 0, 0), True),
        ((0, 90, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), True),
        ((0, 90, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), True),
        ((0, -90, 0), (-1, 0, 0), (1, 0, 0), (0, 0, 1), False),
        ((90, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, 1), True),
    ],
)
def test_ceilings_and_walls(mounting, line, up, ahead, turned):
    found = mounting_frame(line, mounting)
    np.testing.assert_allclose(found.up, up, atol=1e-12)
    np.testing.assert_allclose(found.forward, ahead, atol=1e-12)
    assert found.tool_reversed is turned


def test_a_centre_line_without_direction_is_refused():
    with pytest.raises(ValueError, match="no direction"):
        mounting_frame((0.0, 0.0, 0.0))

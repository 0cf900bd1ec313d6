"""The workspace: laws for every position and every setting, then one example per bound."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from common.errors import ConfigError
from common.limits import BOUNDS, Limit
from kuka_control.model.workspace import (
    Infeasibility,
    Infeasible,
    Workspace,
    boundary_lines,
    workspace_faults,
)

SETTINGS = {
    "center_line": np.array([1.0, -1.0, 0.0]),
    "opening_angle": math.radians(50.0),
    "z_lower": 0.2,
    "z_upper": 0.6,
    "inner_sphere": 0.5,
    "outer_sphere": 0.7,
    "joint_2_height": 0.34,
}
AHEAD = Workspace(**{**SETTINGS, "center_line": np.array([2.0, 0.0, 0.0])})
TOLERANCE = 2e-12


@st.composite
def workspaces(draw):
    heading = draw(st.floats(-math.pi, math.pi))
    z_lower = draw(st.floats(0.1, 1.1))
    settings = {
        "center_line": np.array([math.cos(heading), math.sin(heading), 0.0]) * draw(st.floats(0.1, 10.0)),
        "opening_angle": draw(st.floats(0.01, math.pi - 0.01)),
        "z_lower": z_lower,
        "z_upper": draw(st.floats(z_lower + 1e-3, 1.14)),
        "inner_sphere": 0.4 + draw(st.floats(0.0, 0.39)),
        "joint_2_height": draw(st.sampled_from([0.34, 0.36])),
    }
    settings["outer_sphere"] = draw(st.floats(settings["inner_sphere"] + 1e-3, 0.8))
    assume(not workspace_faults(**settings))
    return Workspace(**settings)


positions = st_numpy.arrays(float, 3, elements=st.floats(-1.5, 1.5))


@given(workspaces(), positions)
def test_a_lifted_workspace_passes_every_position_bit_for_bit_and_keeps_its_centre(workspace, position):
    lifted = dataclasses.replace(workspace, lifted=True)
    assert lifted.lifted and not workspace.lifted
    passed = lifted.constrain(position)
    assert passed.position.tobytes() == position.tobytes() and passed.bounds == ()
    np.testing.assert_array_equal(lifted.centre, workspace.centre)


@pytest.mark.parametrize("position", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (0.0, 0.0)])
def test_a_lifted_workspace_refuses_what_is_no_position(position):
    with pytest.raises(ValueError, match="three finite numbers"):
        Workspace(**SETTINGS, lifted=True).constrain(np.array(position))


def beyond(workspace, position):
    """How far a position is outside each bound [m]; written down again, from the description alone."""
    x, y, z = position
    heading = math.atan2(workspace.center_line[1], workspace.center_line[0])
    outside = []
    for side in (-1.0, 1.0):
        edge = heading + side * workspace.opening_angle / 2.0
        outside.append(side * (-math.sin(edge) * x + math.cos(edge) * y))
    distance = math.sqrt(x * x + y * y + (z - workspace.joint_2_height) ** 2)
    return max(
        *outside,
        workspace.z_lower - z,
        z - workspace.z_upper,
        workspace.inner_sphere - distance,
        distance - workspace.outer_sphere,
    )


@given(workspaces(), positions)
def test_result_is_inside(workspace, position):
    result = workspace.constrain(position)
    if isinstance(result, Infeasible):
        return
    # Distance from joint 2 is the hypotenuse: rounding of the radius counts less than once.
    assert beyond(workspace, result.position) < TOLERANCE
    assert workspace.contains(result.position)


@given(workspaces(), positions)
def test_constraining_twice_changes_nothing(workspace, position):
    once = workspace.constrain(position)
    if isinstance(once, Infeasible):
        return
    twice = workspace.constrain(once.position)
    assert twice.bounds == ()
    np.testing.assert_array_equal(twice.position, once.position)


@given(workspaces(), positions)
def test_position_inside_is_returned_bit_for_bit(workspace, position):
    along = position @ workspace.center_line
    if along <= 1e-9 or beyond(workspace, position) >= 0.0:  # on the base axis there is no way to go
        return
    result = workspace.constrain(position)
    assert result.bounds == ()
    assert result.position.tobytes() == position.tobytes()


@st.composite
def workspaces_and_positions_behind_or_ahead(draw):
    """A workspace, a position that is not on the plane between behind and ahead, and whether it is behind."""
    workspace = draw(workspaces())
    along, left, z = draw(st.floats(1e-6, 1.5)), draw(st.floats(-1.5, 1.5)), draw(st.floats(-1.5, 1.5))
    behind = draw(st.booleans())
    line = workspace.center_line / np.linalg.norm(workspace.center_line)
    aside = np.array([-line[1], line[0], 0.0])
    return workspace, (-along if behind else along) * line + left * aside + np.array([0.0, 0.0, z]), behind


@given(workspaces_and_positions_behind_or_ahead())
def test_infeasible_is_what_lies_behind_or_below(drawn):
    workspace, position, behind = drawn
    assert isinstance(workspace.constrain(position), Infeasible) == (behind or position[2] < 0.0)


@given(workspaces(), positions)
def test_steps_in_their_order(workspace, position):
    """Side plane along its normal, then z, then horizontally along the line from the base axis."""
    result = workspace.constrain(position)
    if isinstance(result, Infeasible):
        return
    assert [b for b in BOUNDS if b in result.bounds] == list(result.bounds)
    heading = math.atan2(workspace.center_line[1], workspace.center_line[0])
    horizontal = np.array([position[0], position[1]])
    if Limit.OPENING_ANGLE in result.bounds:
        side = math.copysign(1.0, math.cos(heading) * position[1] - math.sin(heading) * position[0])
        edge = heading + side * workspace.opening_angle / 2.0
        normal = np.array([-math.sin(edge), math.cos(edge)])
        horizontal = horizontal - (horizontal @ normal) * normal
    z = position[2]
    if {Limit.Z_LOWER, Limit.Z_UPPER} & set(result.bounds):
        z = workspace.z_lower if Limit.Z_LOWER in result.bounds else workspace.z_upper
    assert result.position[2] == z
    if {Limit.INNER_SPHERE, Limit.OUTER_SPHERE} & set(result.bounds):
        limit = workspace.inner_sphere if Limit.INNER_SPHERE in result.bounds else workspace.outer_sphere
        distance = np.linalg.norm(result.position - [0.0, 0.0, workspace.joint_2_height])
        assert distance == pytest.approx(limit, abs=1e-9)
        assume(np.linalg.norm(horizontal) > 1e-6)
        horizontal = horizontal / np.linalg.norm(horizontal) * np.linalg.norm(result.position[:2])
    np.testing.assert_allclose(result.position[:2], horizontal, atol=1e-9)


@given(st.floats(-math.pi, math.pi), positions)
def test_turned_workspace_turns_the_result(turn, position):
    c, s = math.cos(turn), math.sin(turn)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = Workspace(**{**SETTINGS, "center_line": R @ [1.0, 0.0, 0.0]})
    assume(abs(position[0]) > 1e-9 and abs(beyond(AHEAD, position)) > 1e-9)
    here, there = AHEAD.constrain(position), turned.constrain(R @ position)
    assert type(here) is type(there)
    np.testing.assert_allclose(there.position, R @ here.position, atol=1e-9)


@pytest.mark.parametrize(
    "desired, expected, bounds",
    [
        ((0.6, 0.0, 0.34), (0.6, 0.0, 0.34), ()),
        ((0.9, 0.0, 0.34), (0.7, 0.0, 0.34), (Limit.OUTER_SPHERE,)),
        ((0.1, 0.0, 0.34), (0.5, 0.0, 0.34), (Limit.INNER_SPHERE,)),
        ((0.6, 0.0, 0.9), (0.6, 0.0, 0.6), (Limit.Z_UPPER,)),
        ((0.6, 0.0, 0.1), (0.6, 0.0, 0.2), (Limit.Z_LOWER,)),
        ((0.9, 0.0, 0.9), (math.sqrt(0.49 - 0.26**2), 0.0, 0.6), (Limit.Z_UPPER, Limit.OUTER_SPHERE)),
    ],
)
def test_examples(desired, expected, bounds):
    result = AHEAD.constrain(np.array(desired))
    assert result.bounds == bounds
    np.testing.assert_allclose(result.position, expected, atol=1e-12)


@pytest.mark.parametrize(
    "position, reason",
    [
        ((-0.6, 0.0, 0.4), Infeasibility.BEHIND_BASE),
        ((0.0, 0.6, 0.4), Infeasibility.BEHIND_BASE),
        ((0.0, 0.0, 0.4), Infeasibility.BEHIND_BASE),
        ((5e-324, 5e-324, 0.4), Infeasibility.BEHIND_BASE),
        ((0.6, 0.0, -1e-9), Infeasibility.BELOW_BASE),
    ],
)
def test_infeasible_positions(position, reason):
    result = AHEAD.constrain(np.array(position))
    assert isinstance(result, Infeasible)
    assert result.reason is reason
    assert not AHEAD.contains(np.array(position))
    assert reason.value in str(result)


@given(positions)
def test_rooms_tell_how_far_it_is_to_each_bound_and_outward_in_which_direction(position):
    rooms, outward = AHEAD.rooms(position), AHEAD.outward(position)
    np.testing.assert_allclose(np.linalg.norm(outward, axis=1), 1.0)
    assert AHEAD.contains(position) == (position[0] > 0.0 and min(rooms) >= -1e-12)
    step = 1e-6
    for i, normal in enumerate(outward):
        assert AHEAD.rooms(position + step * normal)[i] == pytest.approx(rooms[i] - step, abs=1e-9)


@pytest.mark.parametrize("position", [(math.nan, 0.0, 0.4), (0.6, math.inf, 0.4), (0.6, 0.0)])
def test_what_is_no_position_is_refused(position):
    with pytest.raises(ValueError, match="three finite numbers"):
        AHEAD.constrain(np.array(position))


def test_positions_of_results_cannot_be_changed():
    for position in ([0.6, 0.0, 0.4], [0.9, 0.0, 0.4], [-1.0, 0.0, 0.4]):
        with pytest.raises(ValueError, match="read-only"):
            AHEAD.constrain(np.array(position)).position[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        AHEAD.z_lower = 0.0


@pytest.mark.parametrize(
    "change, words",
    [
        ({"center_line": np.zeros(3)}, "zero vector"),
        ({"center_line": np.array([1.0, 0.0, 0.1])}, "horizontal"),
        ({"center_line": np.array([1.0, np.nan, 0.0])}, "finite"),
        ({"opening_angle": 0.0}, "opening_angle is 0 deg"),
        ({"opening_angle": math.pi}, "opening_angle is 180 deg"),
        ({"opening_angle": math.nan}, "opening_angle is nan deg"),
        ({"z_lower": 0.6}, r"z_lower_limit \(0.6 m\)"),
        ({"z_upper": math.nan}, r"z_upper_limit \(nan m\)"),
        ({"inner_sphere": 0.7}, r"inner_sphere_limit \(0.7 m\)"),
        ({"z_upper": 1.1}, r"z_upper_limit \(1.1 m\) is above the top of the outer sphere, which is 1.04 m"),
        ({"z_lower": 0.9, "z_upper": 1.03, "inner_sphere": 0.41}, "no centre"),
        ({"z_lower": 0.1, "joint_2_height": 0.9}, r"z_lower_limit \(0.1 m\) is below the foot"),
    ],
)
def test_settings_that_make_no_workspace(change, words):
    with pytest.raises(ConfigError, match=words) as raised:
        Workspace(**{**SETTINGS, **change})
    assert raised.value.faults == tuple(workspace_faults(**{**SETTINGS, **change}))


@given(workspaces())
def test_centre_lies_half_way(workspace):
    centre = workspace.centre
    distance = np.linalg.norm(centre - [0.0, 0.0, workspace.joint_2_height])
    assert distance == pytest.approx((workspace.inner_sphere + workspace.outer_sphere) / 2.0, abs=1e-9)
    assert centre[2] == pytest.approx((workspace.z_lower + workspace.z_upper) / 2.0, abs=1e-12)
    line = workspace.center_line / np.linalg.norm(workspace.center_line)
    np.testing.assert_allclose(centre[:2], line[:2] * np.linalg.norm(centre[:2]), atol=1e-12)
    assert workspace.contains(centre)


@given(workspaces())
def test_boundary_lines_lie_on_the_border(workspace):
    lines = boundary_lines(workspace)
    assert len(lines) == 15
    for line in lines:
        assert line.shape[1] == 3
        for point in line:
            assert abs(beyond(workspace, point)) < 1e-7

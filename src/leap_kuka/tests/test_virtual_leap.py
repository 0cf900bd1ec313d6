"""Attitude of the hand, desired rotation of the tool, place of the virtual Leap."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.mounting import mounting_frame
from common.poses import check_pose, pose
from common.rotations import rotation_angle, rotation_from_zyx
from leap_kuka.origin import absolute
from leap_kuka.virtual_leap import (
    R_LEAP_REFERENCE,
    UPRIGHT,
    Attitude,
    SteadyAttitude,
    attitude,
    heading,
    virtual_leap_pose,
)

anywhere = st.floats(-math.pi, math.pi)
tilt = st.floats(-1.4, 1.4)
small = st.floats(-1.0, 1.0)
LIMITS = Attitude(*np.radians([25.0, 25.0, 25.0]))


def hand(yaw, pitch, roll):
    return R_LEAP_REFERENCE @ rotation_from_zyx(yaw, pitch, roll)


def tool_of(angles, psi, tool_reversed):
    """The orientation of the tool for a hand whose yaw counts from psi."""
    return absolute(np.eye(4), psi, tool_reversed).rotation(angles, 0.0)


@given(small, small, small, anywhere)
def test_attitude_gives_back_the_angles_of_the_hand_against_the_heading(yaw, pitch, roll, psi):
    got = attitude(hand(psi + yaw, pitch, roll), psi)
    np.testing.assert_allclose([got.yaw, got.pitch, got.roll], [yaw, pitch, roll], atol=1e-9)


@given(anywhere, tilt, anywhere, anywhere)
def test_an_unclipped_attitude_composes_to_the_hand_again(yaw, pitch, roll, psi):
    R = hand(yaw, pitch, roll)
    np.testing.assert_allclose(tool_of(attitude(R, psi), psi, False), R, atol=1e-7)


@given(anywhere, tilt, anywhere, anywhere)
def test_each_clipped_angle_is_within_its_limit_and_the_others_stay(yaw, pitch, roll, psi):
    measured = attitude(hand(yaw, pitch, roll), psi)
    clipped = measured.clipped(LIMITS)
    for name in ("yaw", "pitch", "roll"):
        angle, limit, result = getattr(measured, name), getattr(LIMITS, name), getattr(clipped, name)
        assert abs(result) <= limit
        assert result == angle if abs(angle) <= limit else result == math.copysign(limit, angle)


def wandering(rng, seconds, rate):
    """Yields orientations of a hand that turns at random between anatomical and stranger poses, with the noise of a
    tracker: yaw and roll all around, pitch up to and past the vertical."""
    spread = rng.uniform(0.2, 1.0) * np.array([math.pi, 1.7, math.pi])
    angles, goal, noise, speed = np.zeros(3), np.zeros(3), rng.uniform(0.0, 0.05), rng.uniform(0.5, 12.0)
    for _ in range(int(seconds * rate)):
        way = goal - angles
        angles = angles + way * min(1.0, speed / rate / max(1e-9, np.abs(way).max()))
        if np.abs(goal - angles).max() < 1e-6:
            goal = rng.uniform(-spread, spread)
        yield hand(*angles) @ rotation_from_zyx(*rng.normal(0.0, noise, 3))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**9), st.sampled_from([20.0, 110.0, 295.0]), anywhere)
def test_the_tool_never_turns_faster_than_a_multiple_of_the_hand(seed, rate, psi):
    """Also where roll passes 180 deg, with the hand upright or on end, and where the angles are replaced."""
    before = steady = None
    for R in wandering(np.random.default_rng(seed), 3.0, rate):
        if steady is None:
            steady = SteadyAttitude(R, psi, LIMITS)
        steady.follow(R)
        tool = tool_of(steady.clipped, psi, True)
        assert np.all(np.abs(steady.clipped.angles) <= np.array(LIMITS.angles) + 1e-12)
        if before is not None:
            assert rotation_angle(before[1].T @ tool) <= 3.0 * rotation_angle(before[0].T @ R) + 1e-6
        before = R, tool


@pytest.mark.parametrize("pitch", [75.0, 80.0, 85.0, 90.0, 100.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_hand_that_points_straight_up_and_rests_leaves_the_tool_at_rest(pitch, seed):
    """With 2 deg of noise on a sample, as the mean of ten shows it: the tool stays within 8 deg, below 60 deg/s."""
    rng, rate = np.random.default_rng(seed), 110.0
    steady = SteadyAttitude(hand(0.0, 0.0, 0.0), 0.0, LIMITS)
    for angle in np.linspace(0.0, np.radians(pitch), 110):
        steady.follow(hand(0.0, angle, 0.0))
    noise = np.radians(2.0) * rng.normal(size=(560, 3))
    means = [noise[i : i + 10].mean(axis=0) for i in range(550)]
    tools = []
    for mean in means:
        steady.follow(hand(0.0, np.radians(pitch), 0.0) @ rotation_from_zyx(*mean))
        tools.append(tool_of(steady.clipped, 0.0, True))
    assert max(rotation_angle(tools[0].T @ T) for T in tools) < np.radians(8.0)
    assert max(rotation_angle(a.T @ b) for a, b in zip(tools, tools[1:])) * rate < np.radians(60.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**9), st.floats(-1.2, 1.2), st.floats(-0.7, 0.7), st.floats(-1.2, 1.2))
def test_wherever_the_hand_was_its_way_back_is_free(seed, yaw, pitch, roll):
    """Once the hand is back in front of the operator and has moved there a little, the tool has its clipped angles."""
    steady = SteadyAttitude(hand(0.0, 0.0, 0.0), 0.0, LIMITS)
    for R in wandering(np.random.default_rng(seed), 2.0, 110.0):
        steady.follow(R)
    for s in np.linspace(0.0, 1.0, 60):
        steady.follow(hand(0.5 * math.sin(6.0 * s) + s * yaw, s * pitch, s * roll))
    steady.follow(hand(yaw, pitch, roll))
    np.testing.assert_allclose(steady.clipped.angles, Attitude(yaw, pitch, roll).clipped(LIMITS).angles, atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_an_angle_that_passes_180_deg_stays_at_its_limit(axis):
    angles = np.zeros(3)
    steady = SteadyAttitude(hand(*angles), 0.0, LIMITS)
    rng = np.random.default_rng(5)
    for angle in np.radians([*np.arange(0.0, 180.0, 2.0), *(180.0 + rng.normal(0.0, 4.0, 500))]):
        angles[axis] = angle
        steady.follow(hand(*angles))
        assert steady.clipped.angles[axis] == pytest.approx(min(angle, LIMITS.angles[axis]), abs=1e-9)
    assert steady.limited == [("yaw", "pitch", "roll")[axis]]


@given(st.floats(-1.5, 1.5), st.floats(-1.0, 1.0), st.floats(-1.5, 1.5))
def test_an_ordinary_hand_is_clipped_as_ever(yaw, pitch, roll):
    """The limit of the turn has no effect on a hand that moves evenly, with little pitch."""
    steady = SteadyAttitude(hand(0.0, 0.0, 0.0), 0.0, LIMITS)
    for s in np.linspace(0.0, 1.0, 50):
        goal = Attitude(*(s * np.array([yaw, 0.75 * pitch, roll])).tolist())
        assert np.all(np.abs(goal.angles) <= UPRIGHT)
        steady.follow(hand(*goal.angles))
        np.testing.assert_allclose(steady.clipped.angles, goal.clipped(LIMITS).angles, atol=1e-9)


def test_the_signs_of_the_angles():
    """Fingers to the right, fingers up, right side down."""
    assert hand(0.1, 0.0, 0.0)[0, 0] > 0.0
    assert hand(0.0, 0.1, 0.0)[1, 0] > 0.0
    assert hand(0.0, 0.0, 0.1)[1, 1] < 0.0


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_the_heading_points_along_the_centre_line_and_the_leap_stands_upright(angle, psi):
    center_line = (math.cos(angle), math.sin(angle), 0.0)
    T = virtual_leap_pose(mounting_frame(center_line), (0.4, -0.3, 0.5), (0.0, 0.45, 0.0), psi)
    check_pose(T)
    np.testing.assert_allclose(T[:3, :3] @ (math.sin(psi), 0.0, -math.cos(psi)), center_line, atol=1e-9)
    np.testing.assert_allclose(T[:3, 1], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [0.4, -0.3, 0.05], atol=1e-12)


@given(anywhere, anywhere, st.tuples(st.floats(-0.3, 0.3), st.floats(0.1, 0.6), st.floats(-0.3, 0.3)))
def test_the_centre_of_a_box_anywhere_falls_on_the_centre_of_the_workspace(angle, psi, center):
    T = virtual_leap_pose(mounting_frame((math.cos(angle), math.sin(angle), 0.0)), (0.4, -0.3, 0.5), center, psi)
    np.testing.assert_allclose((T @ pose(p=center))[:3, 3], [0.4, -0.3, 0.5], atol=1e-12)


def test_heading_is_the_trackers_yaw():
    assert heading((0.0, 0.3, -1.0)) == 0.0
    assert heading((1.0, 0.0, 0.0)) == pytest.approx(math.pi / 2)
    assert heading((-0.1, 0.0, -0.1)) == pytest.approx(-math.pi / 4)

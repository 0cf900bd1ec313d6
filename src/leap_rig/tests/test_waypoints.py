"""A recorded path as lines: they stay near the path, end where it ends, and keep its pace."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import pose
from common.rotations import rotation_from_zyx, scaled_rotation
from leap_rig.recording.recording_files import RecordingFault
from leap_rig.recording.waypoints import OFF_M, distance, lines_along, streamed_motions

SLACK = 1.6 * OFF_M  # the path is sampled, and a sample between two kept ones may be off a little more


def path(seed, count=150):
    """A smooth path with turns and pauses."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 6.0, count)
    shapes = [
        a * np.sin(w * np.maximum(t - 1.0, 0.0) + p)
        for a, w, p in rng.uniform((0.0, 0.2, 0.0), (0.1, 2.0, 6.0), (6, 3))
    ]
    poses = [pose(rotation_from_zyx(*row[3:]), row[:3]) for row in np.array(shapes).T]
    return t, np.array(poses)


def near(T, a, b):
    """The least distance of a pose from the line between two poses."""
    found = []
    for s in np.linspace(0.0, 1.0, 15):
        R = a[:3, :3] @ scaled_rotation(a[:3, :3].T @ b[:3, :3], s)
        found.append(distance(T, pose(R, (1.0 - s) * a[:3, 3] + s * b[:3, 3])))
    return min(found)


@settings(max_examples=8)
@given(seed=st.integers(0, 10**6))
def test_lines_stay_near_the_path(seed):
    times, poses = path(seed, 60)
    lines = lines_along(times, poses, 1.0, 0.3)
    ends = [poses[0], *(line.T_base_tool for line in lines)]
    assert distance(ends[-1], poses[-1]) < 0.02
    for T in poses[::9]:
        assert min(near(T, a, b) for a, b in zip(ends, ends[1:])) < 3.0 * SLACK
    assert all(0.01 <= line.velocity <= 0.3 for line in lines)


def test_a_straight_even_motion_is_one_line_at_its_pace():
    times = np.linspace(10.0, 12.0, 200)
    poses = np.array([pose(p=(0.1 * (t - 10.0), 0.0, 0.5)) for t in times])
    (line,) = lines_along(times, poses, 0.5, 1.0)
    assert line.velocity == pytest.approx(0.05, rel=0.06)
    np.testing.assert_allclose(line.T_base_tool[:3, 3], [0.2, 0.0, 0.5], atol=0.006)


def test_an_arm_that_stood_still_needs_no_line():
    assert lines_along(np.linspace(0.0, 5.0, 50), np.array([np.eye(4)] * 50), 1.0, 0.1) == []
    assert lines_along(np.array([0.0]), np.array([np.eye(4)]), 1.0, 0.1) == []


def test_streams_are_parted_by_ptp_motions_and_pauses():
    times = np.array([0.0, 5.0, 5.1, 5.2, 9.0, 9.1, 9.2, 12.0, 12.1, 13.0])
    x = np.array([9.0, 0.0, 0.1, 0.2, 0.2, 0.3, 0.4, 0.5, 0.5005, 9.0])
    velocities = np.array([0.2, 0, 0, 0, 0, 0, 0, 0, 0, 0.3])
    goals = np.repeat(x[:, None], 7, axis=1)
    motions = streamed_motions(times, goals, velocities, lambda q: pose(p=(q[0], 0.0, 0.0)))
    assert [(motion.q_start[0], motion.times.tolist()) for motion in motions] == [
        (0.0, [5.0, 5.1, 5.2]),
        (0.2, [9.0, 9.1, 9.2]),
    ]
    assert streamed_motions(np.zeros(0), np.zeros((0, 7)), np.zeros(0), lambda q: q) == []


def test_a_short_ptp_motion_parts_two_streams():
    x, velocities = [0.0, 0.1, 9.0, 0.5, 0.6], np.array([0.0, 0.0, 0.2, 0.0, 0.0])
    times, goals = 0.1 * np.arange(5), np.repeat(np.array(x)[:, None], 7, axis=1)
    motions = streamed_motions(times, goals, velocities, lambda q: pose(p=(q[0], 0.0, 0.0)))
    assert [motion.q_start[0] for motion in motions] == [0.0, 0.5]


def half_circle(count):
    angles = np.linspace(0.0, np.pi, count)
    return np.pad(0.1 * np.array([np.cos(angles), np.sin(angles)]).T, ((0, 0), (0, 5)))


def moved(times, goals):
    motions = streamed_motions(times, goals, np.zeros(len(times)), lambda q: pose(p=(q[0], q[1], 0.0)))
    for motion in motions:
        lines = lines_along(motion.times, motion.poses, 1.0, 0.3)
        yield from [motion.poses[0], *(line.T_base_tool for line in lines)]


@pytest.mark.parametrize("step", [-3600.0, -10.0, -0.3, 10.0])
def test_a_clock_that_was_set_while_the_arm_moved_gives_no_short_cut(step):
    times, goals = np.linspace(0.0, 2.0, 100), half_circle(100)
    times[50:] += step
    ends = list(moved(times, goals))
    for q in goals:
        assert min(near(pose(p=(q[0], q[1], 0.0)), a, b) for a, b in zip(ends, ends[1:])) < 2.0 * SLACK


def test_a_goal_that_is_no_number_is_refused_instead_of_cut_off():
    goals = half_circle(100)
    goals[40, 1] = np.nan
    with pytest.raises(RecordingFault, match="not finite"):
        list(moved(np.linspace(0.0, 2.0, 100), goals))

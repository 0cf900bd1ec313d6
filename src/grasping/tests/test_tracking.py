"""Laws of what keeps grasps steady: averaged maps, numbers that stay, poses without jumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from common.poses import check_pose, pose
from common.rotations import rotation_about, rotation_angle, rotation_from_zyx
from grasping.pipeline.tracking import (
    AveragingConfig,
    GraspDetection,
    GraspTracker,
    MapAverage,
    PoseFilter,
    TrackingConfig,
    median,
)

YAML = yaml.safe_load((Path(__file__).parents[1] / "config" / "ggcnn.yaml").read_text())
DOWN = rotation_about(0, np.pi)
DT = 1.0 / 15.0
rng = np.random.default_rng(1)


def tracking(**changes) -> TrackingConfig:
    return parse(TrackingConfig, {**YAML["tracking"], **changes})


def averaging(**changes) -> AveragingConfig:
    return parse(AveragingConfig, {**YAML["averaging"], **changes})


def maps() -> np.ndarray:
    return rng.normal(size=(4, 60, 60)).astype(np.float32)


def test_averaged_maps_of_a_still_scene_go_to_their_mean():
    average, depth = MapAverage(averaging()), np.full((60, 60), 0.7, np.float32)
    truth = maps()
    errors = []
    for i in range(30):
        found, anew = average.step(truth + 0.1 * maps(), depth + 0.001 * rng.normal(size=depth.shape).astype("f4"))
        assert anew == (i == 0)
        errors.append(np.std(found - truth))
    assert np.mean(errors[10:]) < 0.6 * errors[0]


def test_the_average_does_not_hand_out_its_own_memory():
    average, depth, first = MapAverage(averaging()), np.full((60, 60), 0.7, np.float32), maps()
    given_out, _ = average.step(first, depth)
    given_out[:] = 9.0
    np.testing.assert_allclose(average.step(first, depth)[0], first, rtol=1e-6)


def test_where_something_moves_the_average_begins_anew():
    average, depth = MapAverage(averaging()), np.full((60, 60), 0.7, np.float32)
    average.step(maps(), depth)
    flicker = depth.copy()
    flicker[20:40, 20:22] -= 0.05  # an edge, two pixels wide
    assert not average.step(maps(), flicker)[1]
    moved = depth.copy()
    moved[20:30, 20:30] -= 0.05
    newest = maps()
    found, anew = average.step(newest, moved)
    assert anew
    np.testing.assert_array_equal(found, newest)


def test_what_moves_slowly_is_noticed_too():
    average, depth = MapAverage(averaging()), np.full((60, 60), 0.7, np.float32)
    average.step(maps(), depth)
    steps = [average.step(maps(), depth - np.float32(0.007 * i))[1] for i in range(1, 20)]
    assert any(steps)


@given(st.integers(0, 1000), st.integers(1, 9))
def test_the_median_is_numpys(seed, count):
    values = list(np.random.default_rng(seed).normal(size=(count, 9)))
    np.testing.assert_array_equal(median(values), np.median(values, axis=0))


def detection(x: float, quality: float, angle: float = 0.0, y: float = 0.0) -> GraspDetection:
    return GraspDetection(pose(DOWN @ rotation_about(2, angle), (x, y, 0.1)), 0.05, quality)


def best_ids(tracker: GraspTracker, images) -> list[int]:
    return [tracker.step(detections, DT * i)[0].id for i, detections in enumerate(images)]


def test_numbers_stay_with_their_grasps_while_these_shake_and_change_places():
    tracker = GraspTracker(tracking())
    names = {}
    for i in range(20):
        shake = 0.005 * rng.normal(size=3)
        seen = [detection(0.0 + shake[0], 0.8), detection(0.1 + shake[1], 0.75), detection(0.2 + shake[2], 0.7)]
        order = rng.permutation(3)
        for t in tracker.step([seen[k] for k in order], DT * i):
            names.setdefault(int(order[t.detection]), set()).add(t.id)
    assert all(len(ids) == 1 for ids in names.values())
    assert len(set.union(*names.values())) == 3


def test_two_directions_at_one_place_keep_their_numbers_and_poses():
    tracker, found = GraspTracker(tracking()), {}
    for i in range(20):
        shake = 0.004 * rng.normal(size=2)
        seen = [detection(shake[0], 0.8), detection(shake[1], 0.7, np.pi / 2.0)]
        order = rng.permutation(2)
        for t in tracker.step([seen[k] for k in order], DT * i):
            along = abs(t.T[0, 0]) > 0.99
            assert along or abs(t.T[1, 0]) > 0.99
            assert order[t.detection] == (0 if along else 1)
            found.setdefault(bool(along), set()).add(t.id)
    assert sorted(map(len, found.values())) == [1, 1]


def test_the_best_stays_until_a_rival_has_led_for_a_while():
    tracker = GraspTracker(tracking())
    images = [[detection(0.0, 0.6), detection(0.1, 0.55)]] * 3
    images += [[detection(0.0, 0.6), detection(0.1, 0.69)]] * 20  # better, but not by enough
    images += [[detection(0.0, 0.6), detection(0.1, 0.75)]] * 4  # by enough, but not for long enough
    images += [[detection(0.0, 0.6), detection(0.1, 0.6)]]
    images += [[detection(0.0, 0.6), detection(0.1, 0.75)]] * 5
    assert best_ids(tracker, images) == [1] * (len(images) - 1) + [2]


def test_two_rivals_that_take_turns_displace_nobody():
    tracker = GraspTracker(tracking())
    turns = [
        [detection(0.0, 0.5), detection(0.1, 0.7 + 0.1 * (i % 2)), detection(0.2, 0.8 - 0.1 * (i % 2))]
        for i in range(9)
    ]
    first = [[detection(0.0, 0.5)]]
    assert set(best_ids(tracker, first + turns)) == {1}


def test_a_best_grasp_that_becomes_bad_is_given_up_at_once():
    tracker = GraspTracker(tracking())
    assert best_ids(
        tracker, [[detection(0.0, 0.6), detection(0.1, 0.5)], [detection(0.0, 0.25), detection(0.1, 0.5)]]
    ) == [
        1,
        2,
    ]


def test_a_grasp_out_of_sight_keeps_its_number_for_a_while_only():
    tracker = GraspTracker(tracking(keep=0.5))
    assert tracker.step([detection(0.0, 0.6)], 0.0)[0].id == 1
    assert tracker.step([], 0.1) == []
    assert tracker.step([detection(0.0, 0.6)], 0.3)[0].id == 1
    assert tracker.step([], 0.9) == []
    assert tracker.step([detection(0.0, 0.6)], 1.0)[0].id == 2


def test_no_rival_is_published_while_the_best_is_out_of_sight_for_a_moment():
    tracker = GraspTracker(tracking(keep=0.5))
    both, rival = [detection(0.0, 0.7), detection(0.3, 0.6)], [detection(0.3, 0.6)]
    assert [t.id for t in tracker.step(both, 0.0)] == [1, 2] and not tracker.best_out_of_sight
    for now in (0.1, 0.3, 0.5):
        assert tracker.step(rival, now) == [] and tracker.best_out_of_sight
    assert [t.id for t in tracker.step(both, 0.5)] == [1, 2]
    assert tracker.step(rival, 0.9) == []
    assert [t.id for t in tracker.step(rival, 1.1)] == [2], "now it is forgotten"


rotations = st.builds(rotation_from_zyx, st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1))
poses = st.builds(pose, rotations, st.tuples(*[st.floats(-1.0, 1.0)] * 3))


@given(poses, st.floats(0.0, 0.1))
def test_what_does_not_change_comes_out_as_it_went_in(T, width):
    filtered = PoseFilter(tracking())
    for i in range(8):
        found, opening = filtered.step(T, width, DT * i)
    check_pose(found)
    np.testing.assert_allclose(found[:3, [2, 3]], T[:3, [2, 3]], atol=1e-9)
    assert abs(abs(found[:3, 0] @ T[:3, 0]) - 1.0) < 1e-9  # a finger line has no direction
    assert opening == pytest.approx(width, abs=1e-12)


def test_a_finger_line_that_flips_is_the_same_line():
    filtered = PoseFilter(tracking())
    for i in range(10):
        found, _ = filtered.step(pose(DOWN @ rotation_about(2, np.radians(89.0 if i % 2 else -89.0))), 0.05, DT * i)
        assert not filtered.held
    assert abs(found[:3, 0] @ DOWN[:, 1]) > 0.999


def test_noise_shrinks_and_single_jumps_have_no_effect():
    filtered, errors = PoseFilter(tracking()), []
    for i in range(60):
        jump = 0.5 if i % 10 == 9 else 0.0
        T = pose(DOWN @ rotation_about(2, 0.05 * rng.normal()), 0.003 * rng.normal(size=3) + (jump, 0.0, 0.0))
        found, _ = filtered.step(T, 0.05, DT * i)
        assert filtered.held == (jump > 0.0)
        errors.append((np.linalg.norm(found[:3, 3]), rotation_angle(found[:3, :3].T @ DOWN)))
    assert max(e[0] for e in errors[5:]) < 0.006
    assert max(min(e[1], np.pi - e[1]) for e in errors[5:]) < 0.1


def test_a_jump_is_believed_when_five_images_agree():
    filtered = PoseFilter(tracking())
    for i in range(5):
        filtered.step(pose(DOWN), 0.05, DT * i)
    there = pose(DOWN @ rotation_about(2, np.radians(60.0)), (0.05, 0.0, 0.0))
    held = []
    for i in range(5, 10):
        found, _ = filtered.step(there, 0.05, DT * i)
        held.append(filtered.held)
    assert held == [True] * 4 + [False]
    np.testing.assert_allclose(found[:3, 3], there[:3, 3], atol=1e-9)


def test_jumps_that_do_not_agree_are_never_believed():
    filtered = PoseFilter(tracking())
    for i in range(5):
        filtered.step(pose(DOWN), 0.05, DT * i)
    for i in range(5, 30):
        found, _ = filtered.step(pose(DOWN, (0.1 * (1 + i % 3), 0.1 * (i % 2), 0.0)), 0.05, DT * i)
        np.testing.assert_allclose(found[:3, 3], 0.0, atol=1e-9)


def test_the_lag_behind_a_slow_motion_is_below_150_ms():
    filtered, speed = PoseFilter(tracking()), 0.05
    for i in range(40):
        found, _ = filtered.step(pose(DOWN, (speed * DT * i, 0.0, 0.0)), 0.05, DT * i)
    assert (speed * DT * 39 - found[0, 3]) / speed < 0.15 + 1e-6 + DT


def test_an_approach_that_swings_into_the_axis_it_counts_from_is_followed():
    filtered = PoseFilter(tracking(gate_angle=90.0))
    for i in range(91):
        T = pose(rotation_about(1, np.radians(i)) @ rotation_about(2, 0.3))
        found, _ = filtered.step(T, 0.05, DT * i)
        check_pose(found)
    assert found[:3, 2] @ T[:3, 2] > np.cos(np.radians(15.0))

"""Pose from corners: laws on exact corners, statistics on noisy ones, truth on rendered images."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tag_renderer import render

from apriltag_ros.detector import MEMORY_S, TagDetector
from apriltag_ros.settings import TagTarget, TargetTag, detector_settings
from apriltag_ros.tag_pose import CORNER_SIGMA_PX, HINT, REPROJECTION, corner_jacobian, covariance, tag_pose
from common.poses import inverse, pose
from common.rotations import rotation_about, rotation_angle

FACING = np.diag([1.0, -1.0, -1.0])


def view(distance, tilt, azimuth=0.3, turn=0.4, x=0.02, y=-0.03):
    """The pose of a target `distance` m away, tilted by `tilt` deg."""
    R = pin.exp3(np.radians(tilt) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
    return pose(R @ FACING @ rotation_about(2, turn), (x * distance, y * distance, distance))


def corners(target, T, camera):
    """The corners of a target, and exactly where they are seen."""
    points = np.concatenate([tag.corners for tag in target.tags])
    return points, camera.project(points @ T[:3, :3].T + T[:3, 3])


def error(T, truth):
    """Shift and turn from the truth, as in the covariance, shape (6,)."""
    return np.concatenate((T[:3, 3] - truth[:3, 3], pin.log3(T[:3, :3] @ truth[:3, :3].T)))


@settings(max_examples=40)
@example(0.625, 0.0, 0.0, 0.0, 0.1, 0.0, False)  # head-on, where OpenCV's IPPE goes wrong
@example(0.5, 0.75, 1.5707963, 0.0, 0.1, 0.0, False)
@given(
    st.floats(0.5, 2.5), st.floats(0.0, 70.0), st.floats(0.0, 6.3), st.floats(0.0, 6.3), st.floats(-0.12, 0.12),
    st.floats(-0.1, 0.1), st.booleans(),
)  # fmt: skip
def test_exact_corners_give_the_exact_pose(camera, bundle, single, distance, tilt, azimuth, turn, x, y, many):
    truth = view(distance, tilt, azimuth, turn, x, y)
    found = tag_pose(*corners(bundle if many else single, truth, camera), camera)
    assert min(np.linalg.norm(error(T, truth)) for T in (found.T_camera_tag, found.other) if T is not None) < 2e-5
    if found.ratio > 2.0 or tilt > 10.0:
        np.testing.assert_allclose(found.T_camera_tag, truth, atol=2e-5)


def test_a_bundle_that_is_not_flat(camera):
    cube = TagTarget(
        "cube", (TargetTag(0, 0.1, pose(p=(0, 0, 0.06))), TargetTag(1, 0.1, pose(rotation_about(1, 1.2), (0.06, 0, 0))))
    )
    truth = view(0.7, 25.0)
    found = tag_pose(*corners(cube, truth, camera), camera)
    np.testing.assert_allclose(found.T_camera_tag, truth, atol=1e-5)
    assert found.other is None and not found.ambiguous


def test_jacobian_is_the_derivative(camera, bundle):
    T, step = view(0.8, 30.0), 1e-6
    straight = camera.rectified()
    points, before = corners(bundle, T, straight)
    J = corner_jacobian(T, points, straight.K)
    for i in range(6):
        d = np.zeros(6)
        d[i] = step
        moved = pose(pin.exp3(d[3:]) @ T[:3, :3], T[:3, 3] + d[:3])
        np.testing.assert_allclose(
            (corners(bundle, moved, straight)[1] - before) / step, J[:, :, i], rtol=1e-3, atol=0.2
        )


def test_covariance_predicts_the_errors(camera, bundle):
    rng = np.random.default_rng(5)
    truth = view(1.0, 30.0)
    points, exact = corners(bundle, truth, camera)
    squares = []
    for _ in range(120):
        found = tag_pose(points, exact + rng.normal(0.0, CORNER_SIGMA_PX, exact.shape), camera)
        e = error(found.T_camera_tag, truth)
        squares.append(e @ np.linalg.inv(found.covariance) @ e)
    assert 6.0 * 0.78 < np.mean(squares) < 6.0 * 1.22  # chi squared of 6: mean 6, of 120 draws +-0.32


def test_a_far_small_tag_is_ambiguous_and_a_hint_decides(camera, single):
    truth = view(2.2, 25.0)
    points, exact = corners(single, truth, camera)
    rng = np.random.default_rng(2)
    decided = wrong = 0
    for _ in range(40):
        pixels = exact + rng.normal(0.0, 0.35, exact.shape)
        alone = tag_pose(points, pixels, camera)
        assert alone.chosen_by == REPROJECTION
        hinted = tag_pose(points, pixels, camera, truth[:3, :3])
        if hinted.chosen_by == HINT:
            decided += 1
            assert alone.ambiguous
            assert rotation_angle(hinted.T_camera_tag[:3, :3].T @ truth[:3, :3]) <= rotation_angle(
                hinted.other[:3, :3].T @ truth[:3, :3]
            )
            wrong += hinted.ratio < 1.0
    assert decided > 5 and wrong > 0


def test_covariance_allows_for_the_other_pose_where_the_image_does_not_tell(camera, single):
    rng = np.random.default_rng(7)
    squares, of_corners = [], []
    for _ in range(150):
        truth = view(1.4, 12.0, azimuth=rng.uniform(0.0, 6.3))
        points, exact = corners(single, truth, camera)
        found = tag_pose(points, exact + rng.normal(0.0, CORNER_SIGMA_PX, exact.shape), camera)
        e = error(found.T_camera_tag, truth)
        squares.append(e @ np.linalg.solve(found.covariance, e))
        of_corners.append(e @ np.linalg.solve(covariance(found.T_camera_tag, points, camera.K), e))
    assert 4.0 < np.mean(squares) < 9.0  # chi squared of 6
    assert np.mean(of_corners) > 20.0  # a tenth of the poses is tilted the wrong way


def test_covariance_of_a_clear_pose_is_that_of_its_corners(camera, single):
    points, pixels = corners(single, view(0.5, 40.0), camera)
    found = tag_pose(points, pixels, camera)
    np.testing.assert_allclose(found.covariance, covariance(found.T_camera_tag, points, camera.K))


def test_the_bundle_is_not_ambiguous_where_one_tag_is(camera, bundle, single):
    truth = view(1.5, 15.0)
    rng = np.random.default_rng(3)

    def doubts(target):
        points, exact = corners(target, truth, camera)
        return sum(tag_pose(points, exact + rng.normal(0, 0.2, exact.shape), camera).ambiguous for _ in range(20))

    assert doubts(single) > doubts(bundle) == 0


@pytest.mark.parametrize("points", [np.zeros((3, 3)), np.zeros((4, 3))])
def test_what_has_no_pose_is_refused(camera, points):
    with pytest.raises(ValueError, match=r"four corners|no pose"):
        tag_pose(points, np.full((len(points), 2), 100.0), camera)


@pytest.mark.parametrize(("distance", "tilt"), [(0.6, 30.0), (1.0, 25.0), (1.4, 40.0)])
def test_rendered_truth_through_a_distorting_lens(camera, bundle, distance, tilt):
    """Reported in https://github.com/AprilRobotics/apriltag_ros/issues/106: bundles of tags of two sizes. Tried: such
    a bundle.
    """
    detector = TagDetector(detector_settings({"tag_threads": 1, "rectified": False}), (bundle,))
    for seed, azimuth in enumerate((0.5, 2.5, 4.5)):
        truth = view(distance, tilt, azimuth, turn=azimuth, x=0.1)
        tags = [(t.id, t.size, *t.T_target_tag[:2, 3]) for t in bundle.tags]
        image = render(camera, truth, tags, 0.3, seed=seed)
        (found,) = detector.detect(image, camera, float(seed)).targets
        assert len(found.tags) == 5
        e = error(found.pose.T_camera_tag, truth)
        assert np.linalg.norm(e[:3]) < 0.0025 * distance**2
        assert np.degrees(np.linalg.norm(e[3:])) < 0.25
        seen_from_tag = inverse(found.pose.T_camera_tag)[:3, 3] - inverse(truth)[:3, 3]
        assert np.linalg.norm(seen_from_tag) < 0.005 * distance**2
        assert e @ np.linalg.inv(found.pose.covariance) @ e < 25.0


def test_what_was_seen_a_moment_ago_is_the_hint(camera, single):
    detector = TagDetector(detector_settings({"tag_threads": 1, "rectified": False}), (single,))
    near = render(camera, view(0.5, 30.0), [(0, 0.1, 0, 0)], 0.13)
    (found,) = detector.detect(near, camera, 1.0).targets
    np.testing.assert_array_equal(detector._hint("tag", 1.0 + MEMORY_S / 2.0), found.pose.T_camera_tag[:3, :3])
    assert detector._hint("tag", 1.1 + MEMORY_S) is None
    assert detector._hint("tag", 0.9) is None


def test_rectified_images_are_taken_as_they_are(camera, single):
    truth = view(0.6, 30.0)
    image = render(camera.rectified(), truth, [(0, 0.1, 0, 0)], 0.13)
    detector = TagDetector(detector_settings({"tag_threads": 1, "rectified": True}), (single,))
    (found,) = detector.detect(image, camera, 0.0).targets
    np.testing.assert_allclose(found.pose.T_camera_tag[:3, 3], truth[:3, 3], atol=0.0015)


def test_tags_of_no_target_are_reported_and_wrong_sizes_refused(camera, single):
    detector = TagDetector(detector_settings({"tag_threads": 1, "rectified": False}), (single,))
    image = render(camera, view(0.6, 30.0), [(3, 0.1, 0, 0)], 0.13)
    result = detector.detect(image, camera, 0.0)
    assert result.targets == () and result.unknown == (3,)
    with pytest.raises(ValueError, match="64 x 48"):
        detector.detect(image[:48, :64], camera, 0.0)

"""Laws of the marker board's plane and of its pose from colour and depth, on made images with known truth."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from depth_scene import DEPTH, PLATE, RGB, T_RGB_DEPTH, board_pose, depth_image, load
from hypothesis import given, settings
from hypothesis import strategies as st

from apriltag_ros.settings import targets
from apriltag_ros.tag_pose import tag_pose
from common.config import parse
from common.errors import ConfigError
from common.plane_fit import fit_plane
from common.poses import inverse, pose
from common.rotations import rotation_angle, rotation_from_zyx
from vision.marker_board.plane_fit import PlanePoseConfig, fit_board, plane_seen_from
from vision.marker_board.plane_pose import _change, _plane_of, rgbd_pose
from vision.marker_board.pose_evaluation import errors_of

SETTINGS = parse(PlanePoseConfig, load("plane_pose.yaml"))
POINTS = np.concatenate([tag.corners for tag in targets(load("tags.yaml"))[0].tags])
SINGLE = targets(load("tags_single.yaml"))[0].tags[0].corners

poses = st.builds(
    lambda distance, tilt, towards, roll, x, y: board_pose(distance, tilt, towards, roll, x, y),
    st.floats(0.6, 1.8),
    st.floats(0.0, 60.0),
    st.floats(-180.0, 180.0),
    st.floats(-180.0, 180.0),
    st.floats(-0.1, 0.1),
    st.floats(-0.1, 0.1),
)


def see(T, points=POINTS, image=None, pixels=None, plate=PLATE, config=SETTINGS, camera=RGB):
    pixels = RGB.project(points @ T[:3, :3].T + T[:3, 3]) if pixels is None else pixels
    image = depth_image(T, plate) if image is None else image
    T_colour = tag_pose(points, pixels, camera).T_camera_tag
    return rgbd_pose(T_colour, points, pixels, camera, image, DEPTH, T_RGB_DEPTH, plate, config)


@settings(max_examples=15)
@given(T=poses)
def test_without_errors_all_poses_are_the_truth(T):
    result = see(T)
    assert result.reason == ""
    for estimate in (result.plane, result.fused):
        np.testing.assert_allclose(estimate.T_camera_board, T, atol=2e-5)
    assert result.fit.inliers > 0.9
    assert abs(result.disagreement) < 1e-3


@settings(max_examples=12)
@given(T=poses, seed=st.integers(0, 1000))
def test_fused_is_surer_than_either(T, seed):
    rng = np.random.default_rng(seed)
    pixels = RGB.project(POINTS @ T[:3, :3].T + T[:3, 3]) + rng.normal(0.0, 0.2, (len(POINTS), 2))
    result = see(T, pixels=pixels)
    for estimate in (result.plane, result.colour, result.fused):
        assert np.linalg.eigvalsh(estimate.covariance)[0] > 0.0
        np.testing.assert_allclose(estimate.covariance, estimate.covariance.T, rtol=1e-6, atol=1e-15)
    sd = [np.sqrt(np.diag(e.covariance)) for e in (result.plane, result.colour, result.fused)]
    assert np.all(sd[2] <= 1.02 * sd[0])
    assert np.all(sd[2] <= 1.1 * sd[1])


def test_the_stated_covariances_are_those_of_many_trials():
    """White noise of known size, a scale and a focal error drawn anew each time."""
    T = board_pose(1.0, 25.0, 40.0, 30.0)
    config = replace(SETTINGS, warp_sd=0.0, warp_slope_sd=0.0, noise_pixels=1.0)
    rng = np.random.default_rng(3)
    clean = RGB.project(POINTS @ T[:3, :3].T + T[:3, 3])
    truth = 1.0 / depth_image(T)
    errors = {"colour": [], "plane": [], "fused": []}
    for _ in range(60):
        w = truth / (1.0 + config.scale_sd * rng.standard_normal())
        w = w + rng.normal(0.0, 0.002, w.shape)
        K = RGB.K.copy()
        K[[0, 1], [0, 1]] *= 1.0 + config.focal_sd * rng.standard_normal()
        pixels = clean + rng.normal(0.0, config.corner_sd, clean.shape)
        result = see(T, pixels=pixels, image=(1.0 / w).astype(np.float32), config=config, camera=replace(RGB, K=K))
        for name, found in errors.items():
            estimate = getattr(result, name)
            difference = _change(T, estimate.T_camera_board)
            found.append(difference @ np.linalg.solve(estimate.covariance, difference))
    for name, found in errors.items():  # the mean of chi^2 with 6 degrees of freedom, over 60 trials: sd 0.45
        assert 4.3 < np.mean(found) < 8.0, name


def test_depth_does_not_worsen_the_pose_of_five_tags_with_an_exact_lens():
    """A depth camera with the scale of its unit, corners half as noisy as stated, as those of a sharp image."""
    rng = np.random.default_rng(1)
    colour, fused = [], []
    for distance in np.linspace(0.5, 2.0, 40):
        T = board_pose(distance, *rng.uniform((0.0, -180.0, -180.0), (60.0, 180.0, 180.0)))
        pixels = RGB.project(POINTS @ T[:3, :3].T + T[:3, 3]) + rng.normal(0.0, 0.1, (len(POINTS), 2))
        scale = 1.0 + SETTINGS.scale_sd * rng.standard_normal()
        image = depth_image(T, noise=lambda shape: rng.normal(0.0, 0.001, shape)) * np.float32(scale)
        result = see(T, pixels=pixels, image=image)
        for found, estimate in ((colour, result.colour), (fused, result.fused)):
            found.append(errors_of(T, estimate).reach)
    assert np.median(fused) < 1.05 * np.median(colour)
    assert np.percentile(fused, 95) < np.percentile(colour, 95)


def test_depth_turns_a_tag_right_that_faces_the_camera():
    rng = np.random.default_rng(0)
    colour, fused = [], []
    for _ in range(10):
        T = board_pose(1.2, 2.0, rng.uniform(-180, 180))
        pixels = RGB.project(SINGLE @ T[:3, :3].T + T[:3, 3]) + rng.normal(0.0, 0.15, (4, 2))
        result = see(T, SINGLE, pixels=pixels, image=depth_image(T, 0.125), plate=0.125)
        colour.append(rotation_angle(T[:3, :3].T @ result.colour.T_camera_board[:3, :3]))
        fused.append(rotation_angle(T[:3, :3].T @ result.fused.T_camera_board[:3, :3]))
    assert np.median(fused) < 0.2 * np.median(colour)
    assert np.degrees(max(fused)) < 0.5


def test_the_wrong_one_of_two_solutions_is_put_right():
    T = board_pose(1.5, 15.0)
    pixels = RGB.project(SINGLE @ T[:3, :3].T + T[:3, 3])
    wrong = tag_pose(SINGLE, pixels, RGB).other
    result = rgbd_pose(wrong, SINGLE, pixels, RGB, depth_image(T, 0.125), DEPTH, T_RGB_DEPTH, 0.125, SETTINGS)
    assert rotation_angle(T[:3, :3].T @ wrong[:3, :3]) > np.radians(10.0)
    np.testing.assert_allclose(result.fused.T_camera_board, T, atol=1e-3)


@settings(max_examples=10)
@given(T=poses, share=st.floats(0.0, 0.3))
def test_an_arm_before_the_board_and_holes_do_not_bend_it(T, share):
    image = depth_image(T)
    centre = DEPTH.project((inverse(T_RGB_DEPTH) @ T)[:3, 3])
    u = np.arange(DEPTH.width)
    width = 0.88 * PLATE * DEPTH.K[0, 0] / T[2, 3]
    before = u < centre[0] - width / 2.0 + share * width
    image[:, before] -= 0.06
    image[::3] = np.nan
    result = see(T, image=image)
    if result.fused is not None:
        np.testing.assert_allclose(result.plane.T_camera_board, T, atol=2e-3)


def test_what_makes_no_plane_is_refused_with_a_reason():
    T = board_pose(1.0, 20.0)
    rng = np.random.default_rng(0)
    empty = np.full((480, 640), np.nan, np.float32)
    assert "0 pixels" in see(T, image=empty).reason
    assert "0 pixels" in see(T, image=np.full((480, 640), 2.0, np.float32)).reason
    crumpled = depth_image(T, noise=lambda shape: rng.normal(0.0, 0.03, shape))
    assert "in one plane" in see(T, image=crumpled).reason
    beside = pose(T[:3, :3], (3.0, 0.0, 1.0))
    assert fit_board(empty, DEPTH, beside, PLATE, SETTINGS).reason.startswith("the marker board is outside")
    behind = pose(T[:3, :3], (0.0, 0.0, 0.02))
    assert fit_board(empty, DEPTH, behind, PLATE, SETTINGS).reason.startswith("the marker board is outside")
    for result in (see(T, image=empty), see(T, image=crumpled)):
        assert result.fused is None and result.plane is None and np.isnan(result.disagreement)


def test_a_tag_of_another_size_than_configured_is_noticed():
    T = board_pose(1.0, 20.0)
    pixels = RGB.project(0.94 * POINTS @ T[:3, :3].T + T[:3, 3])
    result = see(T, pixels=pixels)
    assert "1.06 times" in result.reason
    assert result.fused is None
    np.testing.assert_allclose(result.plane.T_camera_board, T, atol=1e-3)


@settings(max_examples=15)
@given(T=poses)
def test_derivatives_of_a_poses_plane(T):
    plane, J = _plane_of(T)
    step = 1e-6
    for i, change in enumerate(step * np.eye(6)):
        moved = pose(pin.exp3(change[3:]) @ T[:3, :3], T[:3, 3] + change[:3])
        np.testing.assert_allclose((_plane_of(moved)[0] - plane) / step, J[:, i], atol=1e-4)
    np.testing.assert_allclose(plane @ T[:3, 3], 1.0)


@settings(max_examples=15)
@given(T=poses)
def test_a_plane_seen_from_another_frame_holds_the_same_points(T):
    before, C = _plane_of(T)[0], np.diag([1e-4, 2e-4, 3e-4])
    moved = pose(rotation_from_zyx(0.3, -0.2, 0.4), (0.2, -0.1, 0.15))
    a, covariance = plane_seen_from(moved, before, C)
    points = (POINTS @ T[:3, :3].T + T[:3, 3]) @ moved[:3, :3].T + moved[:3, 3]
    np.testing.assert_allclose(points @ a, 1.0, atol=1e-9)
    step = 1e-6
    J = np.column_stack([(plane_seen_from(moved, before + e, C)[0] - a) / step for e in step * np.eye(3)])
    np.testing.assert_allclose(covariance, J @ C @ J.T, rtol=1e-3, atol=1e-8)


@settings(max_examples=20)
@given(share=st.floats(0.0, 0.4), seed=st.integers(0, 1000))
def test_the_majority_makes_the_plane(share, seed):
    rng = np.random.default_rng(seed)
    rays = np.column_stack((rng.uniform(-0.15, 0.15, (800, 2)), np.ones(800)))
    a = np.array([0.2, -0.3, 1.1])
    w = rays @ a + rng.normal(0.0, 0.002, 800)
    outliers = rng.random(800) < share
    w[outliers] = rays[outliers] @ [0.1, 0.0, 1.2]
    found, weights, sd = fit_plane(rays, w, 0.0025)
    np.testing.assert_allclose(found, a, atol=5e-3)
    assert sd < 0.003
    assert np.mean(weights[~outliers] > 0.0) > 0.95


def test_broken_contracts_are_named():
    T = board_pose(1.0, 20.0)
    with pytest.raises(ValueError, match="depth"):
        see(T, image=np.ones((10, 10), np.float32))
    bent = POINTS + np.linspace(0.0, 0.01, len(POINTS))[:, None] * [0.0, 0.0, 1.0]
    with pytest.raises(ValueError, match="tags.yaml"):
        see(T, bent)


def test_the_file_fits_its_schema_and_bad_values_are_named():
    with pytest.raises(ConfigError, match="min_inliers"):
        parse(PlanePoseConfig, {**load("plane_pose.yaml"), "min_inliers": 0.5})

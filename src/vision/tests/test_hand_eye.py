"""Hand-eye calibration by its laws: exact views give the truth, noise the predicted spread, wrong views do no harm."""

from __future__ import annotations

import numpy as np
import pytest
from hand_eye_scene import SD, difference, direction, scene
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import inverse, pose
from common.rotations import rotation_about
from vision.calibration.hand_eye import (
    CalibrationView,
    DegenerateViews,
    camera_pose,
    information,
    leave_one_out,
    point_sd,
    scales,
    solve,
)


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.integers(5, 16))
def test_exact_views_give_the_truth(seed, count):
    X, Z, views = scene(seed, count)
    result = solve(views)
    np.testing.assert_allclose(result.T_base_camera, Z, atol=1e-9)
    np.testing.assert_allclose(result.T_flange_board, X, atol=1e-9)
    assert result.fits.all()
    np.testing.assert_allclose(result.errors, 0.0, atol=1e-9)


def test_noise_gives_the_spread_that_the_covariance_says():
    squares, ratios = [], []
    for seed in range(40):
        X, Z, views = scene(seed, 14, SD)
        result = solve(views)
        d = np.concatenate((difference(result.T_flange_board, X), difference(result.T_base_camera, Z)))
        squares.append(d @ np.linalg.inv(result.covariance / max(1.0, result.chi2_ratio)) @ d)
        ratios.append(result.chi2_ratio)
    assert 10.0 < np.mean(squares) < 14.0  # chi squared of 12: mean 12, of 40 draws +-0.77
    assert 0.93 < np.mean(ratios) < 1.07


def test_more_views_make_it_surer_and_points_near_the_board_are_surest():
    few, many = (solve(scene(4, count, SD)[2]) for count in (6, 24))
    assert np.sqrt(many.covariance[6, 6]) < 0.8 * np.sqrt(few.covariance[6, 6])
    X, Z, views = scene(4, 24, SD)
    near = (views[0].T_base_flange @ X)[:3, 3]
    assert point_sd(many, near) < 0.7 * point_sd(many, Z[:3, 3])


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_wrong_views_are_left_out(seed, wrong):
    """Reported in https://github.com/IFL-CAMP/easy_handeye/issues/13: the result changes with each sample. Tried:
    turns about one axis; wrong views.
    """
    X, Z, views = scene(seed, 12, SD)
    rng = np.random.default_rng(seed + 1)
    for i in range(wrong):  # a flipped board, or one that was moved
        spoilt = views[i].T_camera_board @ (pose(rotation_about(i % 2, 0.7)) if i % 2 else pose(p=direction(rng) * 0.1))
        views[i] = CalibrationView(views[i].T_base_flange, spoilt, views[i].covariance)
    result = solve(views)
    assert not result.fits[:wrong].any()
    assert result.fits[wrong:].sum() >= 11 - wrong
    without = solve(views[wrong:])
    if without.fits.all() and result.fits[wrong:].all():
        np.testing.assert_allclose(result.T_base_camera, without.T_base_camera, atol=1e-8)


def test_turns_about_one_axis_are_refused():
    """Reported in https://github.com/marcoesposito1988/easy_handeye2/issues/14: a robot that only shifts. Tried:
    views without turns.
    Reported in https://github.com/lagadic/vision_visp/issues/106: six samples of one pose. Tried: six equal views.
    """
    X, Z, _ = scene(1)
    rng = np.random.default_rng(3)
    B = [pose(rotation_about(2, a), rng.uniform(-0.3, 0.3, 3)) for a in np.linspace(-1.2, 1.2, 12)]
    views = [CalibrationView(b, inverse(Z) @ b @ X, np.diag(SD**2)) for b in B]
    with pytest.raises(DegenerateViews, match="axis"):
        solve(views)
    with pytest.raises(DegenerateViews, match="3"):
        solve(views[:2])
    for still in (
        [views[0]] * 6,
        [CalibrationView(pose(p=b[:3, 3]), v.T_camera_board, v.covariance) for b, v in zip(B, views)],
    ):
        with pytest.raises(DegenerateViews, match="axis"):
            solve(still)


def test_a_view_on_which_all_hangs_cannot_be_checked_by_the_others():
    X, Z, _ = scene(1)
    B = [pose(rotation_about(2, a), (a, 0, 0.1)) for a in np.linspace(-1.2, 1.2, 10)]
    B.append(pose(rotation_about(0, 0.5), (0, 0, 0.3)))
    views = [CalibrationView(b, inverse(Z) @ b @ X, np.diag(SD**2)) for b in B]
    result = solve(views)
    np.testing.assert_allclose(result.T_base_camera, Z, atol=1e-8)
    np.testing.assert_array_equal(np.isnan(leave_one_out(views, result)[:, 0]), [False] * 10 + [True])


def test_leave_one_out_finds_what_a_single_view_hides():
    X, Z, views = scene(8, 12, SD)
    result = solve(views)
    predicted = leave_one_out(views, result)
    assert np.all(predicted[:, 0] > 0.9 * np.linalg.norm(result.errors[:, :3], axis=1).min())
    assert np.nanmean(predicted[:, 0]) > np.mean(np.linalg.norm(result.errors[:, :3], axis=1))


def test_the_inverse_covariance_is_the_sum_of_the_information():
    X, Z, views = scene(8, 12)
    result = solve(views)
    total = sum(information(v.T_base_flange, X, Z, v.covariance) for v in views)
    np.testing.assert_allclose(np.linalg.inv(result.covariance), total, rtol=1e-3, atol=1e-3 * np.abs(total).max())


@pytest.mark.parametrize(("size", "ahead"), [(1.0, 1.0), (0.98, 1.0), (1.0, 1.01), (1.01, 0.99)])
def test_wrong_scales_are_seen_by_the_motion_of_the_arm(size, ahead):
    _, _, views = scene(2, 20, SD / 4)
    wrong = [
        CalibrationView(
            v.T_base_flange,
            pose(v.T_camera_board[:3, :3], size * v.T_camera_board[:3, 3] * (1.0, 1.0, ahead)),
            v.covariance,
        )
        for v in views
    ]
    found, sds = scales(wrong, solve(wrong))
    np.testing.assert_allclose(found, (size, ahead), atol=max(3.0 * sds.max(), 5e-4))
    assert sds.max() < 0.02


def test_one_view_and_a_known_board():
    X, Z, views = scene(2)
    np.testing.assert_allclose(camera_pose(views[0], X), Z, atol=1e-12)

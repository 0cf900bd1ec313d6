"""Two arms registered by one camera: the truth is found, and within the stated uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from hand_eye_scene import SD, change, difference, random_pose, scene
from numpy.testing import assert_allclose

from common.poses import inverse
from vision.calibration.arm_registration import register
from vision.calibration.hand_eye import HandEyeSolution, solve


def solution(T_base_camera, covariance=None):
    whole = np.zeros((12, 12))
    if covariance is not None:
        whole[6:, 6:] = covariance
    return HandEyeSolution(T_base_camera, np.eye(4), whole, np.ones(3, bool), np.zeros((3, 6)), 1.0)


@pytest.mark.parametrize("seed", range(8))
def test_views_without_noise_give_the_truth(seed):
    _, first, views = scene(seed)
    _, second, others = scene(100 + seed)
    found = register(solve(views), solve(others))
    assert_allclose(found.T_first_second, first @ inverse(second), atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_the_covariance_is_that_of_small_changes_of_both_calibrations(seed):
    """Against the difference quotient, for each of the twelve changes."""
    rng = np.random.default_rng(seed)
    A, B = random_pose(rng, 1.0), random_pose(rng, 1.0)
    exact, step = register(solution(A), solution(B)).T_first_second, 1e-6
    J = np.empty((6, 12))
    for i in range(12):
        x = np.zeros(12)
        x[i] = step
        changed = register(solution(change(A, x[:6])), solution(change(B, x[6:]))).T_first_second
        J[:, i] = difference(changed, exact) / step
    roots = rng.normal(size=(2, 6, 6))
    first, second = (root @ root.T for root in roots)
    expected = J[:, :6] @ first @ J[:, :6].T + J[:, 6:] @ second @ J[:, 6:].T
    found = register(solution(A, first), solution(B, second)).covariance
    assert_allclose(found, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_the_errors_are_as_large_as_stated():
    """The squared error in its own standard deviations has the mean 6."""
    squares, points = [], []
    for seed in range(30):
        _, first, views = scene(seed, 12, SD)
        _, second, others = scene(1000 + seed, 12, SD)
        found, truth = register(solve(views), solve(others)), first @ inverse(second)
        error = difference(found.T_first_second, truth)
        squares.append(error @ np.linalg.solve(found.covariance, error))
        point = truth @ (0.5, 0.0, 0.0, 1.0)
        seen = found.T_first_second @ inverse(truth) @ point
        points.append(np.linalg.norm(seen - point) / found.point_sd(point[:3]))
    assert 4.0 < np.mean(squares) < 9.0
    assert 0.6 < np.sqrt(np.mean(np.square(points))) < 1.5

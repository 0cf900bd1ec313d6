"""Robot-world and hand-eye calibration: the pose of a fixed camera from views of a marker board that the arm holds.

In every view the marker board's pose is the same by both chains, `T_base_flange T_flange_board = T_base_camera
T_camera_board`, with two unknown poses. The start is the closed form of Shah (2013) for three views at a time, of which
the one with the least median of squares over all views is kept, so that wrong views do no harm. Gauss-Newton steps then
minimise the errors of the consistent views, each weighted by the covariance of its view.
A small change of a pose has six numbers: a translation, then a rotation about axes through the pose's own origin, both
along the axes of the frame in which the pose is given [m, rad]."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, compress

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from common.poses import inverse, pose, read_only

MIN_SECOND_AXIS_RAD = np.radians(4.0)  # minimum rms rotation of the flange about a second axis
MAX_STEPS = 30


class DegenerateViews(ValueError):
    """The views do not determine the calibration."""


@dataclass(frozen=True, eq=False)
class CalibrationView:
    """The arm at one pose, and the marker board in the camera there."""

    T_base_flange: np.ndarray  # measured by the arm, shape (4, 4) [m]
    T_camera_board: np.ndarray  # measured by the camera, shape (4, 4) [m]
    covariance: np.ndarray  # of small changes of T_camera_board, errors of the arm included, shape (6, 6)


@dataclass(frozen=True, eq=False)
class HandEyeSolution:
    """The two poses that fit the views best."""

    T_base_camera: np.ndarray  # shape (4, 4) [m]
    T_flange_board: np.ndarray  # shape (4, 4) [m]
    covariance: np.ndarray  # of small changes of T_flange_board, then of T_base_camera, shape (12, 12)
    fits: np.ndarray  # which views are consistent and used, shape (n,), bool
    errors: np.ndarray  # of each view, from the measured to the expected board, shape (n, 6) [m, rad]
    chi2_ratio: float  # mean square of the used views' weighted errors; about 1 if their covariances are right


def solve(views: list[CalibrationView], seed: int = 0) -> HandEyeSolution:
    """Returns the calibration; views may be wrong as long as more than half are right. The seed is that of the choice
    of triples, if there are more than 60. Raises DegenerateViews if there are fewer than three views, or the
    flange turns about one axis only."""
    check_motion(views)
    X, Z = _robust_start(views, np.random.default_rng(seed))
    fits = _fitting(views, X, Z)
    for _ in range(MAX_STEPS):
        kept = list(compress(views, fits))
        check_motion(kept)
        X, Z, _, _ = _least_squares(kept, X, Z)
        before, fits = fits, _fitting(views, X, Z)
        if np.array_equal(before, fits):
            break
    fits = before
    X, Z, covariance, chi2_ratio = _least_squares(list(compress(views, fits)), X, Z)
    errors = np.array([_error(view, X, Z) for view in views])
    covariance = covariance * max(1.0, chi2_ratio)
    return HandEyeSolution(read_only(Z), read_only(X), read_only(covariance), fits, read_only(errors), chi2_ratio)


def camera_pose(view: CalibrationView, T_flange_board: np.ndarray) -> np.ndarray:
    """Returns T_base_camera, shape (4, 4), from one view and the known pose of the marker board on the flange."""
    return view.T_base_flange @ T_flange_board @ inverse(view.T_camera_board)


def leave_one_out(views: list[CalibrationView], result: HandEyeSolution) -> np.ndarray:
    """Returns the distance of each consistent view from the prediction of the others, shape (n, 2) [m, rad]. The rest
    are nan, and so are views without which the flange would turn about one axis only."""
    predicted = np.full((len(views), 2), np.nan)
    for i in np.flatnonzero(result.fits):
        others = [view for k, view in enumerate(views) if result.fits[k] and k != i]
        try:
            check_motion(others)
        except DegenerateViews:
            continue
        X, Z, _, _ = _least_squares(others, result.T_flange_board, result.T_base_camera)
        error = _error(views[i], X, Z)
        predicted[i] = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
    return predicted


def scales(views: list[CalibrationView], result: HandEyeSolution) -> tuple[np.ndarray, np.ndarray]:
    """Returns two scale factors of the camera, estimated from the arm's motion, and their standard deviations. The
    first is the factor by which everything appears too large: 1 unless the printed tag size differs from the configured
    one. The second is the factor by which the marker board appears too far away: 1 unless the focal length is wrong,
    which leaves sideways translations as they are. Both results have the shape (2,)."""
    X, Z = result.T_flange_board, result.T_base_camera
    rows, errors = [], []
    for view in compress(views, result.fits):
        W, p = _whitening(view), view.T_camera_board[:3, 3]
        change = np.zeros((6, 2))
        change[:3, 0], change[2, 1] = p, p[2]
        rows.append(W @ np.hstack((_error_jacobian(view, X, Z), change)))
        errors.append(W @ _error(view, X, Z))
    J = np.concatenate(rows)
    too_much = -np.linalg.lstsq(J, np.concatenate(errors), rcond=None)[0][-2:]
    variances = np.diag(np.linalg.inv(J.T @ J))[-2:] * max(1.0, result.chi2_ratio)
    return 1.0 + too_much, np.sqrt(variances)


def point_sd(result: HandEyeSolution, point: ArrayLike) -> float:
    """Returns the standard deviation in the base [m] of a `point`, shape (3,) [m], that the camera measured exactly."""
    lever = np.asarray(point) - result.T_base_camera[:3, 3]
    J = np.hstack((np.eye(3), -pin.skew(lever)))
    return float(np.sqrt(np.trace(J @ result.covariance[6:, 6:] @ J.T)))


def check_motion(views: list[CalibrationView]) -> None:
    """Raises DegenerateViews if the views cannot determine the calibration."""
    min_views = 3
    if len(views) < min_views:
        raise DegenerateViews(f"a calibration needs {min_views} consistent views, not {len(views)}: take more")
    turns = [pin.log3(a.T_base_flange[:3, :3].T @ b.T_base_flange[:3, :3]) for a, b in combinations(views, 2)]
    second = np.linalg.svd(turns, compute_uv=False)[1] / np.sqrt(len(turns))
    if second < MIN_SECOND_AXIS_RAD:
        raise DegenerateViews(
            f"the flange turned about nearly one axis only ({np.degrees(second):.1f} deg about others, "
            f"{np.degrees(MIN_SECOND_AXIS_RAD):.0f} deg are needed): turn it about different axes between the views"
        )


def information(
    T_base_flange: np.ndarray, T_flange_board: np.ndarray, T_base_camera: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """Returns the Fisher information that a view adds to the calibration, shape (12, 12)."""
    J = _jacobian(T_base_flange, T_flange_board, T_base_camera)
    return J.T @ np.linalg.solve(covariance, J)


def _robust_start(views: list[CalibrationView], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    max_triples = 60  # with nearly half of the views wrong, no triple is free of them in one case of 50 000
    triples = list(combinations(range(len(views)), 3))
    if len(triples) > max_triples:
        triples = [triples[i] for i in rng.choice(len(triples), max_triples, replace=False)]
    best, least = None, np.inf
    for triple in triples:
        chosen = [views[i] for i in triple]
        try:
            check_motion(chosen)
        except DegenerateViews:
            continue
        start = _closed_form(chosen)
        median = float(np.median([_square(view, *start) for view in views]))
        if median < least:
            best, least = start, median
    return _closed_form(views) if best is None else best


def _closed_form(views: list[CalibrationView]) -> tuple[np.ndarray, np.ndarray]:
    """Returns T_flange_board and T_base_camera that fit rotations first, then positions (Shah 2013)."""
    B, C = [view.T_base_flange for view in views], [view.T_camera_board for view in views]
    R_x, p_x, R_z, p_z = cv2.calibrateRobotWorldHandEye(
        [T[:3, :3] for T in B], [T[:3, 3] for T in B], [T[:3, :3] for T in C], [T[:3, 3] for T in C],
        method=cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    )  # fmt: skip
    return pose(R_x, p_x.ravel()), pose(R_z, p_z.ravel())


def _least_squares(
    views: list[CalibrationView], X: np.ndarray, Z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Returns T_flange_board, T_base_camera, their covariance, and the mean weighted square of the errors."""
    converged = 1e-12
    whitenings = [_whitening(view) for view in views]
    for _ in range(MAX_STEPS):
        J = np.concatenate([W @ _error_jacobian(view, X, Z) for W, view in zip(whitenings, views)])
        e = np.concatenate([W @ _error(view, X, Z) for W, view in zip(whitenings, views)])
        step = -np.linalg.lstsq(J, e, rcond=None)[0]
        X, Z = _changed(X, step[:6]), _changed(Z, step[6:])
        if np.max(np.abs(step)) < converged:
            break
    freedom = max(6 * len(views) - 12, 1)
    return X, Z, np.linalg.inv(J.T @ J), float(e @ e / freedom)


def _whitening(view: CalibrationView) -> np.ndarray:
    """Returns the matrix that whitens the view's errors, shape (6, 6)."""
    return np.linalg.inv(np.linalg.cholesky(_floored(view.covariance)))


def _error(view: CalibrationView, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns translation and rotation from the measured to the expected board, shape (6,) [m, rad]."""
    expected, measured = inverse(Z) @ view.T_base_flange @ X, view.T_camera_board
    return np.concatenate((expected[:3, 3] - measured[:3, 3], pin.log3(expected[:3, :3] @ measured[:3, :3].T)))


def _error_jacobian(view: CalibrationView, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns the derivative of `_error` by small changes of X, then of Z, shape (6, 12)."""
    J = _jacobian(view.T_base_flange, X, Z)
    turn = Z[:3, :3].T @ view.T_base_flange[:3, :3] @ X[:3, :3] @ view.T_camera_board[:3, :3].T
    J[3:] = pin.Jlog3(turn).T @ J[3:]
    return J


def _jacobian(B: np.ndarray, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns the derivative of the board's pose in the camera by small changes of X, then of Z, shape (6, 12)."""
    R_camera_base = Z[:3, :3].T
    J = np.zeros((6, 12))
    J[:3, :3] = J[3:, 3:6] = R_camera_base @ B[:3, :3]
    J[:3, 6:9] = J[3:, 9:] = -R_camera_base
    J[:3, 9:] = R_camera_base @ pin.skew(B[:3, :3] @ X[:3, 3] + B[:3, 3] - Z[:3, 3])
    return J


def _square(view: CalibrationView, X: np.ndarray, Z: np.ndarray) -> float:
    error = _error(view, X, Z)
    return float(error @ np.linalg.solve(_floored(view.covariance), error))


def _fitting(views: list[CalibrationView], X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns which views agree with the poses, by a bound that widens if all covariances are too small."""
    chi2_median = 5.348  # of chi-squared with six degrees of freedom
    chi2_bound = 22.458  # its 99.9 % quantile
    squares = np.array([_square(view, X, Z) for view in views])
    return squares <= chi2_bound * max(1.0, np.median(squares) / chi2_median)


def _floored(covariance: np.ndarray) -> np.ndarray:
    rounding_sd = 1e-10  # smallest standard deviation [m, rad]: noise-free views would divide by zero
    return covariance + rounding_sd**2 * np.eye(6)


def _changed(T: np.ndarray, change: np.ndarray) -> np.ndarray:
    return pose(pin.exp3(change[3:]) @ T[:3, :3], T[:3, 3] + change[:3])

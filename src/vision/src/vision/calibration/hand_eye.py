"""Where a fixed camera stands, from views of a panel that the arm holds: robot-world and hand-eye calibration.

In every view base to flange to panel is the same place as base to camera to panel, `T_base_flange T_flange_panel =
T_base_camera T_camera_panel`, with two unknown poses. The start is the closed form with Kronecker products (Shah 2013)
of three views at a time, of which the one counts that most views agree with (least median of squares), so that views
with a wrong pose do no harm. From there Gauss-Newton steps lead to the least squares of the errors, each weighed by the
covariance of its view, over the views that fit.

Small changes of a pose are six numbers: the shift, then the turn about axes through the pose's own origin, both along
the axes of the frame in which the pose is given [m, rad].
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from common.poses import inverse, pose, read_only

MIN_VIEWS = 3
MIN_SECOND_AXIS_RAD = np.radians(4.0)
"""The flange has to turn about several axes: the least root mean square turn about the second of them."""

MAX_TRIPLES = 60
"""With nearly half of the views wrong, one of so many triples is free of them but for one case in 50 000."""

MAX_STEPS = 30
CONVERGED = 1e-12
CHI2_MEDIAN, CHI2_BOUND = 5.348, 22.458
"""Median, and the bound of 99.9 %, of the sum of the squares of six standard normal numbers."""

ROUNDING_SD = 1e-10
"""Never are the errors taken for smaller [m, rad]: noise-free views would ask for a division by zero."""


class Degenerate(ValueError):
    """The views do not determine the calibration."""


@dataclass(frozen=True, eq=False)
class View:
    """The arm at one place, and the panel as the camera sees it there.

    Attributes:
        T_base_flange: measured by the arm, shape (4, 4) [m].
        T_camera_panel: measured by the camera, shape (4, 4) [m].
        covariance: of the small changes of T_camera_panel, errors of the arm included, shape (6, 6).
    """

    T_base_flange: np.ndarray
    T_camera_panel: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class HandEye:
    """The two poses that fit the views best.

    Attributes:
        T_base_camera, T_flange_panel: shape (4, 4) [m].
        covariance: of the small changes of T_flange_panel, then of T_base_camera, shape (12, 12).
        fits: which views the solution is made of, shape (n,), bool.
        errors: shift and turn of the seen panel against the expected one in each view, shape (n, 6) [m, rad].
        chi2_ratio: mean square of the fitting views' weighed errors; about 1 if their covariances are true.
    """

    T_base_camera: np.ndarray
    T_flange_panel: np.ndarray
    covariance: np.ndarray
    fits: np.ndarray
    errors: np.ndarray
    chi2_ratio: float


def solve(views: list[View], seed: int = 0) -> HandEye:
    """Returns the calibration from views of which some may be wrong, if more than half are right.

    Args:
        views: three at least.
        seed: of the choice of triples where there are more than can all be tried.

    Raises:
        Degenerate: there are too few views, or the flange turns about one axis only.
    """
    check_motion(views)
    X, Z = _robust_start(views, np.random.default_rng(seed))
    fits = _fitting(views, X, Z)
    for _ in range(MAX_STEPS):
        kept = [view for view, fit in zip(views, fits) if fit]
        check_motion(kept)
        X, Z, _, _ = _least_squares(kept, X, Z)
        before, fits = fits, _fitting(views, X, Z)
        if np.array_equal(before, fits):
            break
    fits = before
    kept = [view for view, fit in zip(views, fits) if fit]
    X, Z, covariance, chi2_ratio = _least_squares(kept, X, Z)
    errors = np.array([_error(view, X, Z) for view in views])
    covariance = covariance * max(1.0, chi2_ratio)
    return HandEye(read_only(Z), read_only(X), read_only(covariance), fits, read_only(errors), chi2_ratio)


def camera_pose(view: View, T_flange_panel: np.ndarray) -> np.ndarray:
    """Returns T_base_camera, shape (4, 4), from one view and the known place of the panel on the flange."""
    return view.T_base_flange @ T_flange_panel @ inverse(view.T_camera_panel)


def leave_one_out(views: list[View], result: HandEye) -> np.ndarray:
    """Returns how far each fitting view is from what the other ones predict, shape (n, 2) [m, rad]; nan for the rest.

    So are views of which the others say nothing, because without them all turns are about one axis.
    """
    predicted = np.full((len(views), 2), np.nan)
    for i in np.flatnonzero(result.fits):
        others = [view for k, view in enumerate(views) if result.fits[k] and k != i]
        try:
            check_motion(others)
        except Degenerate:
            continue
        X, Z, _, _ = _least_squares(others, result.T_flange_panel, result.T_base_camera)
        error = _error(views[i], X, Z)
        predicted[i] = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
    return predicted


def scales(views: list[View], result: HandEye) -> tuple[np.ndarray, np.ndarray]:
    """Returns what the arm's motion tells of the camera: two factors, shape (2,), and their standard deviations.

    The first is by how much everything looks too large: 1 but for tags of another size than is stated. The second is by
    how much the panel looks too far ahead: 1 but for a wrong focal length, which leaves its shift sideways as it is.
    """
    X, Z = result.T_flange_panel, result.T_base_camera
    rows, errors = [], []
    for view, fits in zip(views, result.fits):
        if fits:
            W, p = _whitening(view), view.T_camera_panel[:3, 3]
            change = np.zeros((6, 2))
            change[:3, 0], change[2, 1] = p, p[2]
            rows.append(W @ np.hstack((_error_jacobian(view, X, Z), change)))
            errors.append(W @ _error(view, X, Z))
    J = np.concatenate(rows)
    too_much = -np.linalg.lstsq(J, np.concatenate(errors), rcond=None)[0][-2:]
    variances = np.diag(np.linalg.inv(J.T @ J))[-2:] * max(1.0, result.chi2_ratio)
    return 1.0 + too_much, np.sqrt(variances)


def point_sd(result: HandEye, point: ArrayLike) -> float:
    """Returns the standard deviation of a point that the camera measured exactly, in the base [m].

    Args:
        result: the calibration.
        point: in the base, shape (3,) [m].
    """
    lever = np.asarray(point) - result.T_base_camera[:3, 3]
    J = np.hstack((np.eye(3), -pin.skew(lever)))
    return float(np.sqrt(np.trace(J @ result.covariance[6:, 6:] @ J.T)))


def check_motion(views: list[View]) -> None:
    """Raises Degenerate if the views cannot determine the calibration."""
    if len(views) < MIN_VIEWS:
        raise Degenerate(f"a calibration needs {MIN_VIEWS} views that fit together, not {len(views)}")
    turns = [pin.log3(a.T_base_flange[:3, :3].T @ b.T_base_flange[:3, :3]) for a, b in combinations(views, 2)]
    second = np.linalg.svd(turns, compute_uv=False)[1] / np.sqrt(len(turns))
    if second < MIN_SECOND_AXIS_RAD:
        raise Degenerate(
            f"the flange has turned about nearly one axis only (about others by {np.degrees(second):.1f} deg, needed "
            f"are {np.degrees(MIN_SECOND_AXIS_RAD):.0f} deg): turn it about different axes between the views"
        )


def information(
    T_base_flange: np.ndarray, T_flange_panel: np.ndarray, T_base_camera: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """Returns what a view would add to the inverse of the calibration's covariance, shape (12, 12)."""
    J = _jacobian(T_base_flange, T_flange_panel, T_base_camera)
    return J.T @ np.linalg.solve(covariance, J)


def _robust_start(views: list[View], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    triples = list(combinations(range(len(views)), 3))
    if len(triples) > MAX_TRIPLES:
        triples = [triples[i] for i in rng.choice(len(triples), MAX_TRIPLES, replace=False)]
    best, least = None, np.inf
    for triple in triples:
        chosen = [views[i] for i in triple]
        try:
            check_motion(chosen)
        except Degenerate:
            continue
        start = _closed_form(chosen)
        median = float(np.median([_square(view, *start) for view in views]))
        if median < least:
            best, least = start, median
    return _closed_form(views) if best is None else best


def _closed_form(views: list[View]) -> tuple[np.ndarray, np.ndarray]:
    """Returns T_flange_panel and T_base_camera that fit turns first, then places."""
    rows = []
    for view in views:
        R_b, R_c = view.T_base_flange[:3, :3], view.T_camera_panel[:3, :3]
        rows.append(np.hstack((np.kron(np.eye(3), R_b), -np.kron(R_c.T, np.eye(3)))))
    vector = np.linalg.svd(np.concatenate(rows))[2][-1]
    R_x, R_z = (_nearest_rotation(part.reshape(3, 3, order="F")) for part in (vector[:9], vector[9:]))
    A = np.concatenate([np.hstack((view.T_base_flange[:3, :3], -np.eye(3))) for view in views])
    b = np.concatenate([R_z @ view.T_camera_panel[:3, 3] - view.T_base_flange[:3, 3] for view in views])
    p = np.linalg.lstsq(A, b, rcond=None)[0]
    return pose(R_x, p[:3]), pose(R_z, p[3:])


def _nearest_rotation(M: np.ndarray) -> np.ndarray:
    """Returns the rotation nearest to a multiple of M; the multiple may be negative."""
    u, _, vt = np.linalg.svd(M * np.sign(np.linalg.det(M)))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _least_squares(views: list[View], X: np.ndarray, Z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Returns T_flange_panel, T_base_camera, their covariance, and the mean weighed square of the errors."""
    whitenings = [_whitening(view) for view in views]
    for _ in range(MAX_STEPS):
        J = np.concatenate([W @ _error_jacobian(view, X, Z) for W, view in zip(whitenings, views)])
        e = np.concatenate([W @ _error(view, X, Z) for W, view in zip(whitenings, views)])
        step = -np.linalg.lstsq(J, e, rcond=None)[0]
        X, Z = _changed(X, step[:6]), _changed(Z, step[6:])
        if np.max(np.abs(step)) < CONVERGED:
            break
    freedom = max(6 * len(views) - 12, 1)
    return X, Z, np.linalg.inv(J.T @ J), float(e @ e / freedom)


def _whitening(view: View) -> np.ndarray:
    """Returns the matrix that makes the view's errors independent, with standard deviation 1, shape (6, 6)."""
    return np.linalg.inv(np.linalg.cholesky(_floored(view.covariance)))


def _error(view: View, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns shift and turn from the seen panel to the expected one, along the camera's axes, shape (6,) [m, rad]."""
    expected, seen = inverse(Z) @ view.T_base_flange @ X, view.T_camera_panel
    return np.concatenate((expected[:3, 3] - seen[:3, 3], pin.log3(expected[:3, :3] @ seen[:3, :3].T)))


def _error_jacobian(view: View, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns the derivative of `_error` by small changes of X, then of Z, shape (6, 12)."""
    J = _jacobian(view.T_base_flange, X, Z)
    turn = Z[:3, :3].T @ view.T_base_flange[:3, :3] @ X[:3, :3] @ view.T_camera_panel[:3, :3].T
    J[3:] = pin.Jlog3(turn).T @ J[3:]
    return J


def _jacobian(B: np.ndarray, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns how the panel in the camera changes with small changes of X, then of Z, shape (6, 12)."""
    R_camera_base = Z[:3, :3].T
    J = np.zeros((6, 12))
    J[:3, :3] = J[3:, 3:6] = R_camera_base @ B[:3, :3]
    J[:3, 6:9] = J[3:, 9:] = -R_camera_base
    J[:3, 9:] = R_camera_base @ pin.skew(B[:3, :3] @ X[:3, 3] + B[:3, 3] - Z[:3, 3])
    return J


def _square(view: View, X: np.ndarray, Z: np.ndarray) -> float:
    error = _error(view, X, Z)
    return float(error @ np.linalg.solve(_floored(view.covariance), error))


def _fitting(views: list[View], X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Returns which views agree with the poses, by a bound that widens if all covariances turn out too small."""
    squares = np.array([_square(view, X, Z) for view in views])
    return squares <= CHI2_BOUND * max(1.0, np.median(squares) / CHI2_MEDIAN)


def _floored(covariance: np.ndarray) -> np.ndarray:
    return covariance + ROUNDING_SD**2 * np.eye(6)


def _changed(T: np.ndarray, change: np.ndarray) -> np.ndarray:
    return pose(pin.exp3(change[3:]) @ T[:3, :3], T[:3, 3] + change[:3])

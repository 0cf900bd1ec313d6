"""Rotations as 3x3 matrices and unit quaternions (x, y, z, w), refused when they are not rotations. Pinocchio does most
of the arithmetic; this module adds the conventions of the rig and the checks of its inputs. `R_a_b` is the orientation
of b in a: its columns are the axes of b written in a."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

UNIT_TOLERANCE = 1e-3  # the norm of a quaternion or axis may be this far from 1 to be normalised instead of refused

_PRODUCTS = np.array([
    [1, 0, 0, 0, -1, 0, 0, 0, -1], [0, 1, 0, 1, 0, 0, 0, 0, 0],
    [0, 0, 1, 0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, -1, 0, 1, 0],
    [0, 1, 0, 1, 0, 0, 0, 0, 0], [-1, 0, 0, 0, 1, 0, 0, 0, -1],
    [0, 0, 0, 0, 0, 1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0],
    [0, 0, 1, 0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 1, 0, 1, 0],
    [-1, 0, 0, 0, -1, 0, 0, 0, 1], [0, -1, 0, 1, 0, 0, 0, 0, 0],
    [0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0],
    [0, -1, 0, 1, 0, 0, 0, 0, 0], [1, 0, 0, 0, 1, 0, 0, 0, 1],
], dtype=float).T  # fmt: skip
_ONES = np.eye(4).ravel()
"""R, row by row, times _PRODUCTS, plus _ONES, is 4 q q' of the quaternion q = x, y, z, w of the rotation R."""
_SIDE = np.array([0.5, 0.75, 0.2, 0.4])  # of the two quaternions of a rotation, the one to this side


def unit(vector: ArrayLike) -> np.ndarray:
    """Returns vector / |vector|, shape (n,); raises ValueError if the vector is zero or not finite."""
    v = np.asarray(vector, dtype=float)
    norm = math.sqrt(v @ v)
    if not math.isfinite(norm) or norm < 1e-12:
        raise ValueError(f"the vector {v.tolist()} has no direction")
    return v / norm


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the cross product of two vectors, shape (3,); np.cross, made for arrays of them, is slow."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array((a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0))


def rotation_about(axis: int, angle: float) -> np.ndarray:
    """Returns the rotation by `angle` [rad] about coordinate axis 0, 1 or 2, shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def check_rotation(R: ArrayLike, tolerance: float = 1e-6) -> np.ndarray:
    """Returns R as a float array, shape (3, 3); raises ValueError if R is not finite, not orthonormal within
    `tolerance`, or a reflection."""
    R = np.asarray(R, dtype=float)
    if R.shape != (3, 3) or not all(map(math.isfinite, R.ravel().tolist())):
        raise ValueError(f"a rotation needs 3 x 3 finite numbers, not {R.tolist()}")
    x, y, z = R.tolist()
    error = max(abs(_dot(x, x) - 1.0), abs(_dot(y, y) - 1.0), abs(_dot(z, z) - 1.0))
    if max(error, abs(_dot(x, y)), abs(_dot(y, z)), abs(_dot(z, x))) > tolerance:
        raise ValueError(f"the matrix {R.tolist()} is not orthonormal")
    if (
        z[0] * (x[1] * y[2] - x[2] * y[1]) + z[1] * (x[2] * y[0] - x[0] * y[2]) + z[2] * (x[0] * y[1] - x[1] * y[0])
        < 0.0
    ):
        raise ValueError(f"the matrix {R.tolist()} is a reflection, not a rotation")
    return R


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def quaternion_from_rotation(R: ArrayLike) -> np.ndarray:
    """Returns the quaternion x, y, z, w with w >= 0, shape (4,), of the rotation R, shape (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(R, dtype=float).tolist()
    if a + e + i > 0.0:
        x, y, z, w = h - f, c - g, d - b, 1.0 + a + e + i
    elif a >= e and a >= i:
        x, y, z, w = 1.0 + a - e - i, b + d, c + g, h - f
    elif e >= i:
        x, y, z, w = b + d, 1.0 - a + e - i, f + h, c - g
    else:
        x, y, z, w = c + g, f + h, 1.0 - a - e + i, d - b
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return np.array([x, y, z, w]) / (-norm if w < 0.0 else norm)


def quaternions_from_rotations(R: np.ndarray) -> np.ndarray:
    """Returns the quaternions x, y, z, w with w >= 0, shape (n, 4), of n rotations, shape (n, 3, 3), all at once."""
    products = R.reshape(-1, 9) @ _PRODUCTS + _ONES
    row = np.where(products[:, 15] > 1.0, 3, np.argmax(products[:, :15:5], axis=1))
    q = products.reshape(-1, 4, 4)[np.arange(len(row)), row]
    return q / (np.sqrt((q * q).sum(axis=1)) * np.where(q[:, 3] < 0.0, -1.0, 1.0))[:, None]


def steady_quaternion(q: ArrayLike) -> np.ndarray:
    """Returns q or -q, which are one rotation, shape (..., 4), x, y, z, w. A tool that points down may turn about the
    vertical by any multiple of 45 degrees, and by up to 20 degrees from there, before its numbers jump, which a network
    cannot learn; in some other orientations they jump sooner."""
    q = np.asarray(q, dtype=float)
    return q * np.where(q @ _SIDE < 0.0, -1.0, 1.0)[..., None]


def rotation_from_quaternion(q: ArrayLike) -> np.ndarray:
    """Returns the rotation, shape (3, 3), of the quaternion x, y, z, w, shape (4,); raises ValueError if its numbers
    are not finite, or its norm is off by more than `UNIT_TOLERANCE`."""
    q = np.asarray(q, dtype=float)
    if q.shape != (4,) or not np.all(np.isfinite(q)):
        raise ValueError(f"a quaternion needs four finite numbers, not {q.tolist()}")
    norm = np.linalg.norm(q)
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"the quaternion {q.tolist()} has norm {norm:.6g} instead of 1")
    return pin.Quaternion(*(q[[3, 0, 1, 2]] / norm)).toRotationMatrix()


def rotation_from_zyx(a: float, b: float, c: float) -> np.ndarray:
    """Returns Rz(a) Ry(b) Rx(c), shape (3, 3); angles in rad. KUKA's A, B, C are these angles."""
    return pin.rpy.rpyToMatrix(c, b, a)


def zyx_from_rotation(R: ArrayLike) -> tuple[float, float, float]:
    """Returns a, b, c [rad] with R = Rz(a) Ry(b) Rx(c), b in [-pi/2, pi/2]; at |b| = pi/2 one of the many solutions."""
    c, b, a = pin.rpy.matrixToRpy(np.asarray(R, dtype=float))
    return float(a), float(b), float(c)


def rotation_angle(R: ArrayLike) -> float:
    """Returns the angle [rad], 0 to pi, by which the rotation R, shape (3, 3), turns."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(R, dtype=float).tolist()
    return math.atan2(math.hypot(h - f, c - g, d - b), a + e + i - 1.0)


def scaled_rotation(R: ArrayLike, factor: float) -> np.ndarray:
    """Returns the rotation about the axis of R, shape (3, 3), by `factor` times its angle, shape (3, 3)."""
    return pin.exp3(factor * pin.log3(np.asarray(R, dtype=float)))

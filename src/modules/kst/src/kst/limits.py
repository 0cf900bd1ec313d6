"""The last check before numbers leave for the arm: seven finite joint angles within their ranges, a velocity in (0,
1], a rigid pose. The server checks nothing, and a joint angle that is not a number makes it deaf for good. Angles in
degrees or poses in millimetres that end up here by mistake are outside the ranges."""

from __future__ import annotations

from dataclasses import dataclass, field
from operator import le

import numpy as np
from numpy.typing import ArrayLike

from kst.errors import BadJoints, BadVelocity

JOINTS = 7


def read_only(values: ArrayLike) -> np.ndarray:
    """Returns a read-only float copy of `values`, for frozen records."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Ranges of the joint angles, from `lower` to `upper`, shape (7,) each [rad]; ValueError: not seven, or empty."""

    lower: np.ndarray
    upper: np.ndarray
    _lowest: list[float] = field(init=False, repr=False)  # the same as plain numbers, for the check of each goal
    _highest: list[float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            bound = getattr(self, name)
            if bound.shape != (JOINTS,) or not np.all(np.isfinite(bound)):
                raise ValueError(f"the {name} joint limits need seven finite angles, not {bound.tolist()}")
        if np.any(self.lower >= self.upper):
            raise ValueError(f"the joint limits {self.lower.tolist()} to {self.upper.tolist()} leave no range")
        object.__setattr__(self, "_lowest", self.lower.tolist())
        object.__setattr__(self, "_highest", self.upper.tolist())

    def check(self, q: ArrayLike) -> np.ndarray:
        """Returns the joint angles q [rad] as a float array, shape (7,); BadJoints: not seven numbers in range."""
        try:
            angles = np.array(q, dtype=float)
        except (TypeError, ValueError) as error:
            raise BadJoints(f"the joint angles {q!r} are not numbers; nothing was sent") from error
        if angles.shape != (JOINTS,):
            raise BadJoints(f"seven joint angles are needed, not an array of shape {angles.shape}; nothing was sent")
        values = angles.tolist()
        if not (all(map(le, self._lowest, values)) and all(map(le, values, self._highest))):
            first = int(np.argmin((angles >= self.lower) & (angles <= self.upper)))
            low, high, angle = np.degrees([self.lower[first], self.upper[first], angles[first]])
            hint = " (degrees instead of radians?)" if np.any(np.abs(angles) > 2.0 * np.pi) else ""
            outside = f"joint {first + 1} at {angle:.6g} deg is outside its range {low:.6g} to {high:.6g} deg{hint}"
            raise BadJoints(f"{outside}; nothing was sent", joint=first + 1)
        return angles


LBR_IIWA_RANGE = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
LBR_IIWA_LIMITS = JointLimits(-LBR_IIWA_RANGE, LBR_IIWA_RANGE)
"""Joint ranges of the LBR iiwa 7 R800 and 14 R820 (KUKA, LBR iiwa specification, axis data)."""


def check_relative_velocity(velocity: float) -> float:
    """Returns the relative velocity of a PTP motion as a float; BadVelocity: it is not a number in (0, 1]."""
    try:
        value = float(velocity)
    except (TypeError, ValueError) as error:
        raise BadVelocity(f"the relative velocity {velocity!r} is not a number; nothing was sent") from error
    if not 0.0 < value <= 1.0:
        raise BadVelocity(f"the relative velocity {value:g} is not in (0, 1]; nothing was sent")
    return value


def check_pose(T: ArrayLike) -> np.ndarray:
    """Returns T as a read-only float array, shape (4, 4). Raises ValueError: not finite, not rigid (scale, shear,
    mirror), or the last row is not 0 0 0 1."""
    rigid_tolerance = 1e-6
    T = read_only(T)
    if T.shape != (4, 4) or not np.all(np.isfinite(T)):
        raise ValueError(f"a pose needs 4 x 4 finite numbers, not {T.tolist()}")
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > rigid_tolerance or np.linalg.det(R) < 0.0:
        raise ValueError(f"the rotation {R.tolist()} of the pose is not orthonormal and right-handed")
    if not np.array_equal(T[3], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError(f"the last row of a pose is 0 0 0 1, not {T[3].tolist()}")
    return T

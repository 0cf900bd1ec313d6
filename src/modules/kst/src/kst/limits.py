"""The last check before numbers leave for the arm: seven finite joint angles within their ranges, a velocity in (0, 1].

The server checks nothing, and a joint angle that is not a number deafens it for good. Angles in degrees or poses in
millimetres that end up here by mistake fall outside the ranges and are refused like any other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from common.poses import read_only
from kst.errors import BadJoints, BadVelocity

JOINTS = 7


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Joint ranges.

    Attributes:
        lower: smallest angles, shape (7,) [rad].
        upper: largest angles, shape (7,) [rad].

    Raises:
        ValueError: not seven finite ranges, or an empty one.
    """

    lower: np.ndarray
    upper: np.ndarray

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            bound = getattr(self, name)
            if bound.shape != (JOINTS,) or not np.all(np.isfinite(bound)):
                raise ValueError(f"the {name} joint limits need seven finite angles, not {bound.tolist()}")
        if np.any(self.lower >= self.upper):
            raise ValueError(f"the joint limits {self.lower.tolist()} to {self.upper.tolist()} leave no range")

    def check(self, q: ArrayLike) -> np.ndarray:
        """Returns the joint angles q [rad] as a float array, shape (7,).

        Raises:
            BadJoints: not seven finite numbers, or a joint outside its range.
        """
        try:
            angles = np.array(q, dtype=float)
        except (TypeError, ValueError) as error:
            raise BadJoints(f"the joint angles {q!r} are not numbers; nothing was sent") from error
        if angles.shape != (JOINTS,):
            raise BadJoints(f"seven joint angles are needed, not an array of shape {angles.shape}; nothing was sent")
        if not np.all(np.isfinite(angles)):
            bad = int(np.flatnonzero(~np.isfinite(angles))[0])
            raise BadJoints(f"the angle of joint {bad + 1} is {angles[bad]}, not a number; nothing was sent")
        outside = np.flatnonzero((angles < self.lower) | (angles > self.upper))
        if outside.size:
            raise BadJoints(self._sentence(angles, int(outside[0])))
        return angles

    def _sentence(self, angles: np.ndarray, bad: int) -> str:
        low, high = np.degrees(self.lower[bad]), np.degrees(self.upper[bad])
        hint = " (degrees in the place of radians?)" if np.abs(angles).max() > 2.0 * np.pi else ""
        return (
            f"joint {bad + 1} at {np.degrees(angles[bad]):.6g} deg is outside its range"
            f" {low:.6g} to {high:.6g} deg{hint}; nothing was sent"
        )


LBR_IIWA_RANGE = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
LBR_IIWA_LIMITS = JointLimits(-LBR_IIWA_RANGE, LBR_IIWA_RANGE)
"""Joint ranges of the LBR iiwa 7 R800 and 14 R820 (reference: kst.md, 4)."""


def check_relative_velocity(velocity: float) -> float:
    """Returns the relative velocity of a PTP motion as a float, in (0, 1].

    Raises:
        BadVelocity: not a number in (0, 1].
    """
    try:
        value = float(velocity)
    except (TypeError, ValueError) as error:
        raise BadVelocity(f"the relative velocity {velocity!r} is not a number; nothing was sent") from error
    if not 0.0 < value <= 1.0:
        raise BadVelocity(f"the relative velocity {value:g} is not in (0, 1]; nothing was sent")
    return value

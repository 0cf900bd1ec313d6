"""Inverse kinematics in closed form: joints for a tool pose that continue from the joints of a seed. The pose fixes
the wrist, and with it the bend of the elbow. The free angle on the elbow's circle and the branch are chosen in
`elbow_choice`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import atan2, copysign, hypot, isfinite, sqrt
from typing import Sequence

import numpy as np

from iiwa_kinematics.chain import (
    Ball,
    Vector,
    combination,
    cross,
    fastest_point,
    forward,
    jacobian,
    tool_point,
    zyz_axes,
)
from iiwa_kinematics.elbow_choice import ElbowChoice
from iiwa_kinematics.elbow_circle import Branch, ElbowCircle, wrapped
from iiwa_kinematics.robot_model import RobotModel, read_only

UPRIGHT = 1e-6
"""Below this sine of the angle between the line shoulder - wrist and the vertical, the arm angle counts from base x."""


class IkFailure(str, Enum):
    """Why there are no joints for a tool pose."""

    TOO_FAR = "The tool pose is out of reach: too far from the shoulder for the outstretched arm."
    TOO_NEAR = "The tool pose is out of reach: so near to the shoulder that joint 4 would bend beyond its limit."
    OTHER_BRANCH = (
        "The tool pose is out of reach, unless the arm is folded differently first: joint 2, 4 or 6 turned over."
    )
    NO_ARM_ANGLE = "The tool pose is out of reach: at every arm angle some joint would be beyond its limit."
    NOT_REFINED = "The tool pose is out of reach of the calibrated arm; an arm as in the data sheet would reach it."

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class IkResult:
    """Joints for a tool pose, or the reason of the failure."""

    q: np.ndarray | None  # joints, shape (7,) [rad]; None after a failure
    failure: IkFailure | None = None  # None if there are joints
    arm_angle: float | None = None  # about shoulder - wrist, from the vertical plane above it to the elbow [rad]
    branch: Branch | None = None  # signs of joints 2, 4 and 6


class Kinematics:
    """An arm with its tool, as in its data sheet; `T_flange_tool`: pose of the tool in the flange, shape (4, 4) [m],
    the flange itself if omitted; `elbow_preference`: arm angle to which the elbow slowly returns [rad], 0 is up."""

    calibrated = False  # whether this arm differs from the one that the robot's own controller computes with
    slack = 0.0, 0.0  # how much earlier this arm's reach may end than the data sheet's, in length [m] and angle [rad]

    def __init__(
        self, model: RobotModel, T_flange_tool: np.ndarray | None = None, elbow_preference: float = 0.0
    ) -> None:
        self.model = model
        self.T_flange_tool = read_only(np.eye(4) if T_flange_tool is None else T_flange_tool)
        self.T_tool_flange = inverse_pose(self.T_flange_tool)
        self._tool: Vector = tuple(self.T_flange_tool[:3, 3].tolist())
        self._lengths = (model.shoulder_elbow, model.elbow_wrist)
        self._elbow = ElbowChoice(model, elbow_preference)

    def forward(self, q: np.ndarray) -> np.ndarray:
        """Returns the pose of the tool in the base, shape (4, 4) [m], at joints q, shape (7,) [rad]."""
        return forward(self.model, q) @ self.T_flange_tool

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Returns the geometric Jacobian of the tool point in the base frame, shape (6, 7); rows 0-2 linear."""
        return jacobian(self.model, q, self.T_flange_tool)

    def tool_point(self, q: Sequence[float], around: float = 0.0) -> tuple[Vector, list[float]]:
        """Returns the tool point in the base [m], and how far the moving arm reaches from the 7 joint axes [m]. The
        arm is elbow, wrist, and what is within `around` [m] of the tool point, at 7 joints q [rad]."""
        return tool_point(self.model, self._tool, q, around)

    def fastest_point(self, balls: Sequence[Ball], q: Sequence[float], v: Sequence[float]) -> float:
        """Returns the speed of the fastest point of elbow, wrist, flange and balls on it [m/s]. `q`: joints, 7
        [rad], `v`: their speeds, 7 [rad/s]."""
        return fastest_point(self.model, balls, q, v)

    def refined(self, q: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray | None:
        """Returns joints near q, shape (7,) [rad], that bring this arm to a pose to which q brings the nominal arm.
        Here the two arms are the same. A calibrated arm may not reach the pose, shape (4, 4) [m]: then None."""
        return q

    def inverse(self, T_base_tool: np.ndarray, q_seed: np.ndarray, keep_branch: bool = False) -> IkResult:
        """Returns joints that bring the tool to a pose, close to the seed. Raises ValueError: the pose is not finite or
        not rigid, or the seed is not seven finite numbers.

        Args:
            T_base_tool: pose of the tool in the base, shape (4, 4) [m].
            q_seed: joints to continue from, shape (7,) [rad]: the present ones of the arm.
            keep_branch: whether the arm follows a path: then the branch of the seed is left only where joint 2 or joint
                6 is near zero, and it is a failure that it does not reach the pose. Otherwise the arm moves there from
                rest, and the joints are those of all branches to which the motion takes the least time."""
        reach_tolerance_m = 1e-10  # a target beyond the outstretched arm by at most this is a rounding error
        T, seed_array = self._checked(T_base_tool, q_seed)
        seed = seed_array.tolist()
        flange, position = _axes_and_position(T @ self.T_tool_flange)
        w = combination(1.0, position, -self.model.wrist_flange, flange[2])
        w = (w[0], w[1], w[2] - self.model.base_shoulder)
        reach = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        upper_arm, forearm = self._lengths
        if reach > upper_arm + forearm + reach_tolerance_m:
            return IkResult(None, IkFailure.TOO_FAR)
        bend = 2.0 * atan2(
            sqrt(max((upper_arm + forearm) ** 2 - reach * reach, 0.0)),
            sqrt(max(reach * reach - (upper_arm - forearm) ** 2, 0.0)),
        )
        if not self._elbow.can_bend(bend):
            return IkResult(None, IkFailure.TOO_NEAR)

        u = (w[0] / reach, w[1] / reach, w[2] / reach)
        reference = _elbow_across(u, seed)
        zero = _arm_angle(u, reference)
        circle = ElbowCircle(bend, self._lengths, u, reference, flange)
        best = self._elbow.continued(circle, seed) if keep_branch else self._elbow.quickest(circle, seed)
        if best is None:
            other = keep_branch and self._elbow.quickest(circle, seed) is not None
            return IkResult(None, IkFailure.OTHER_BRANCH if other else IkFailure.NO_ARM_ANGLE)
        best = self._elbow.led_back(circle, best, seed, zero)
        return IkResult(read_only(best.q), arm_angle=wrapped(best.angle + zero), branch=Branch.of(best.q))

    @staticmethod
    def _checked(T_base_tool: np.ndarray, q_seed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns both as arrays; ValueError: wrong shape, or not finite."""
        seed = np.asarray(q_seed, dtype=float)
        if seed.shape != (7,) or not all(map(isfinite, seed.tolist())):
            raise ValueError(f"the seed must be seven finite joint angles, not {seed.tolist()}")
        T = np.asarray(T_base_tool, dtype=float)
        if T.shape != (4, 4) or not isfinite(sum(map(sum, T.tolist()))):
            raise ValueError(f"a pose needs 4 x 4 finite numbers, not {T.tolist()}")
        return T, seed


def _elbow_across(u: Vector, q: list[float]) -> Vector:
    """Returns the unit vector across u (shoulder to wrist) to the elbow for which the axis of joint 4 changes least."""
    axis = zyz_axes(q[0], q[1], q[2])[1]
    sign = copysign(1.0, q[3])
    for h in ((sign * axis[0], sign * axis[1], sign * axis[2]), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)):
        e = cross(h, u)
        length = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
        if length > 0.1:
            break
    return e[0] / length, e[1] / length, e[2] / length


def _axes_and_position(T: np.ndarray) -> tuple[tuple[Vector, Vector, Vector], Vector]:
    """Returns the columns of a rigid pose; ValueError: it is not rigid."""
    rigid_tolerance = 1e-6  # how far the columns of a target's rotation may be from orthonormal
    x, y, z, p = map(tuple, T.T[:, :3].tolist())
    xy = cross(x, y)
    errors = (
        abs(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] - 1.0),
        abs(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] - 1.0),
        abs(xy[0] - z[0]),
        abs(xy[1] - z[1]),
        abs(xy[2] - z[2]),
    )
    if max(errors) > rigid_tolerance:
        raise ValueError(f"the pose {T.tolist()} is not rigid")
    return (x, y, z), p


def _arm_angle(u: Vector, e: Vector) -> float:
    """Returns the angle about u [rad] from the vertical plane above u (from base x where u is vertical) to e."""
    if hypot(u[0], u[1]) < UPRIGHT:
        return atan2(e[1] * u[2], e[0])
    return atan2(e[0] * u[1] - e[1] * u[0], e[2])


def inverse_pose(T: np.ndarray) -> np.ndarray:
    """Returns the inverse of a rigid pose, shape (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse

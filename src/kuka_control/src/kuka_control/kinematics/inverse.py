"""Inverse kinematics in closed form: joints for a tool pose, chosen to go on from the joints that the arm has.

The target leaves one angle free (the elbow's place on its circle) and up to eight branches. What is wanted, in this
order: within all joint ranges; close to the present joints; then, slowly, back to the preferred arm angle and away from
the ends of joint ranges and from the singular poses in which joint 2 or joint 6 is at zero.

Close means a small weighted joint step in which joint 3 counts most: with joint 3 nearly held the arm moves like one
with six joints, its elbow stays in its plane, and the tool may pass over places where joint 2 goes through zero without
any joint racing. The slow return adds no more than a share of the joint step that the tool asks for, so an arm whose
tool stands still does not move.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import atan2, hypot, isfinite, pi, radians, sqrt
from typing import Sequence

import numpy as np

from common.poses import inverse as inverse_pose
from common.poses import read_only
from kuka_control.kinematics.arcs import TURN, Interval, nearest
from kuka_control.kinematics.chain import Vector, combination, cross, forward, jacobian, zyz_axes
from kuka_control.kinematics.elbow_circle import BRANCHES, Branch, ElbowCircle, Limits, wrapped
from kuka_control.robot_model import RobotModel

REACH_TOLERANCE_M = 1e-10
"""A target beyond the outstretched arm by no more than this is rounding."""

JOINT_TOLERANCE_RAD = 1e-10
"""A joint out of range by no more than this is rounding."""

RIGID_TOLERANCE = 1e-6
"""How far the columns of a target's rotation may be from orthonormal."""

JOINT_3_WEIGHT = 10.0
"""How much more a step of joint 3 costs than one of another joint."""

RETURN_SHARE = 0.25
"""How much of the joint step that the tool asks for may be added to lead the arm angle back."""

MARGIN_RAD = radians(5.0)
"""The arm angle is led away where a joint is nearer to its limit than this, or joint 2 or 6 nearer to zero."""

NEARBY_RAD = radians(3.0)
"""A solution with no greater joint step is taken without a look at others."""

CROSSING_RAD = radians(10.0)
"""A joint goes through zero where it is nearer to zero than this before and after the step."""

WOUND = -0.5
"""Below this cosine of joint 3 the elbow is where it should be with joints 1 and 3 turned over, which is not wanted."""

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
    NOT_REFINED = (
        "The tool pose is out of reach: the calibrated arm does not come there, one as in the data sheet would."
    )

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class IkResult:
    """Joints for a tool pose, or why there are none.

    Attributes:
        q: joints, shape (7,) [rad]; None if there are none.
        failure: None if there are joints.
        arm_angle: about the line from shoulder to wrist, from the vertical plane above it to the elbow [rad].
        branch: signs of joints 2, 4 and 6.
    """

    q: np.ndarray | None
    failure: IkFailure | None = None
    arm_angle: float | None = None
    branch: Branch | None = None


@dataclass(frozen=True)
class _Candidate:
    cost: float
    angle: float
    q: list[float]
    branch: Branch
    interval: Interval


class Kinematics:
    """An arm with its tool, as in its data sheet.

    Attributes:
        calibrated: whether this arm is another than the one that the robot's controller reckons with.

    Args:
        model: the arm.
        T_flange_tool: pose of the tool in the flange, shape (4, 4) [m]; the flange itself where left out.
        elbow_preference: arm angle that the elbow slowly goes to [rad]; 0 is up.
    """

    calibrated = False

    def __init__(
        self, model: RobotModel, T_flange_tool: np.ndarray | None = None, elbow_preference: float = 0.0
    ) -> None:
        self.model = model
        self.T_flange_tool = read_only(np.eye(4) if T_flange_tool is None else T_flange_tool)
        self._T_tool_flange = inverse_pose(self.T_flange_tool)
        self._elbow_preference = elbow_preference
        self._lengths = (model.shoulder_elbow, model.elbow_wrist)
        self._limits = Limits(model.lower, model.upper)
        self._margins = Limits(model.lower + MARGIN_RAD, model.upper - MARGIN_RAD, MARGIN_RAD)
        speeds = model.max_speed.tolist()
        mean = sum(speeds) / len(speeds)
        self._weights = [(mean / speed) ** 2 for speed in speeds]
        self._weights[2] *= JOINT_3_WEIGHT

    def forward(self, q: np.ndarray) -> np.ndarray:
        """Returns the pose of the tool in the base, shape (4, 4) [m], at joints q, shape (7,) [rad]."""
        return forward(self.model, q) @ self.T_flange_tool

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Returns the geometric Jacobian of the tool point in the base frame, shape (6, 7); rows 0-2 linear."""
        return jacobian(self.model, q, self.T_flange_tool)

    def refined(self, q: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray | None:
        """Returns joints near to q that bring the very arm to a pose that q brings the arm of the data sheet to.

        Here that is the same arm. A calibrated one may not come there: then None.

        Args:
            q: shape (7,) [rad].
            T_base_tool: shape (4, 4) [m].
        """
        return q

    def inverse(self, T_base_tool: np.ndarray, near: np.ndarray, keep_branch: bool = False) -> IkResult:
        """Returns joints that bring the tool to a pose, close to `near`.

        The branch of `near` is left only through a zero of joint 2 or joint 6, or where it does not reach the pose.

        Args:
            T_base_tool: pose of the tool in the base, shape (4, 4) [m].
            near: joints that the arm has, shape (7,) [rad].
            keep_branch: whether that the branch does not reach the pose is a failure.

        Raises:
            ValueError: the pose is not finite or not rigid, or `near` is not seven finite numbers.
        """
        T, present = self._checked(T_base_tool, near)
        seed = present.tolist()
        flange, position = _axes_and_position(T @ self._T_tool_flange)
        w = combination(1.0, position, -self.model.wrist_flange, flange[2])
        w = (w[0], w[1], w[2] - self.model.base_shoulder)
        reach = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        upper_arm, forearm = self._lengths
        if reach > upper_arm + forearm + REACH_TOLERANCE_M:
            return IkResult(None, IkFailure.TOO_FAR)
        bend = 2.0 * atan2(
            sqrt(max((upper_arm + forearm) ** 2 - reach * reach, 0.0)),
            sqrt(max(reach * reach - (upper_arm - forearm) ** 2, 0.0)),
        )
        if not self._bends(bend):
            return IkResult(None, IkFailure.TOO_NEAR)

        u = (w[0] / reach, w[1] / reach, w[2] / reach)
        reference = _elbow_across(u, seed)
        zero = _arm_angle(u, reference)
        circle = ElbowCircle(bend, self._lengths, u, reference, flange)
        best = self._continued(circle, seed)
        if best is None:
            best = self._refolded(circle, seed)
            if best is None:
                return IkResult(None, IkFailure.NO_ARM_ANGLE)
            if keep_branch:
                return IkResult(None, IkFailure.OTHER_BRANCH)
        best = self._led_back(circle, best, seed, zero)
        return IkResult(read_only(best.q), arm_angle=wrapped(best.angle + zero), branch=Branch.of(best.q))

    @staticmethod
    def _checked(T_base_tool: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns both as arrays.

        Raises:
            ValueError: they have not the right shape, or are not finite.
        """
        present = np.asarray(near, dtype=float)
        if present.shape != (7,) or not all(map(isfinite, present.tolist())):
            raise ValueError(f"the present joints must be seven finite numbers, not {present.tolist()}")
        T = np.asarray(T_base_tool, dtype=float)
        if T.shape != (4, 4) or not np.isfinite(T).all():
            raise ValueError(f"a pose needs 4 x 4 finite numbers, not {T.tolist()}")
        return T, present

    def _continued(self, circle: ElbowCircle, seed: list[float]) -> _Candidate | None:
        """Returns the best joints of the present branch, or of one that joint 2 or joint 6 enters through zero."""
        present = Branch.of(seed)
        best = self._best_in_branch(circle, present, seed)
        if best is not None and _step(best.q, seed) <= NEARBY_RAD:
            return best
        for branch in BRANCHES:
            crossed = [joint for joint, a, b in zip((1, 3, 5), branch, present) if a != b]
            if crossed and 3 not in crossed and all(abs(seed[joint]) < CROSSING_RAD for joint in crossed):
                found = self._best_in_branch(circle, branch, seed)
                if found is not None and all(abs(found.q[joint]) < CROSSING_RAD for joint in crossed):
                    best = found if best is None or found.cost < best.cost else best
        return best

    def _refolded(self, circle: ElbowCircle, seed: list[float]) -> _Candidate | None:
        """Returns the best joints of all branches."""
        found = [self._best_in_branch(circle, branch, seed) for branch in BRANCHES]
        reached = [one for one in found if one is not None]
        return min(reached, key=lambda one: one.cost) if reached else None

    def _best_in_branch(self, circle: ElbowCircle, branch: Branch, seed: list[float]) -> _Candidate | None:
        """Returns the joints of a branch that are cheapest to reach from `seed`, or None if it has none in range."""
        if not self._bends(circle.bend * branch.elbow):
            return None
        starts = circle.keeping_joint_3(seed[2], branch) or [0.0 if branch.elbow == Branch.of(seed).elbow else pi]
        best = None
        for interval in circle.free(branch, self._limits):
            for start in starts:
                best = self._descend(circle, branch, interval, nearest(interval, start), seed, best)
            if best is None or _step(best.q, seed) > NEARBY_RAD:
                best = self._descend(circle, branch, interval, (interval[0] + interval[1]) / 2.0, seed, best)
        return best

    def _descend(
        self,
        circle: ElbowCircle,
        branch: Branch,
        interval: Interval,
        angle: float,
        seed: list[float],
        best: _Candidate | None,
    ) -> _Candidate | None:
        """Returns the better of `best` and what Gauss-Newton steps from `angle` find within the interval."""
        for _ in range(3):
            q = self._in_range(circle.joints(angle, branch, seed, self._limits))
            if q is None:
                return best
            differences = [a - b for a, b in zip(q, seed)]
            cost = sum(w * d * d for w, d in zip(self._weights, differences))
            if best is not None and cost >= best.cost:
                return best
            best = _Candidate(cost, angle, q, branch, interval)
            motion = circle.self_motion(q)
            slope = sum(w * m * d for w, m, d in zip(self._weights, motion, differences))
            step = slope / sum(w * m * m for w, m in zip(self._weights, motion))
            angle = min(max(angle - step, interval[0]), interval[1])
        return best

    def _led_back(self, circle: ElbowCircle, found: _Candidate, seed: list[float], zero: float) -> _Candidate:
        """Returns `found`, led back by a small part of its joint step to where the elbow should be."""
        goal = self._goal(circle, found, zero)
        fastest = max(1.0, max(map(abs, circle.self_motion(found.q))))
        most = RETURN_SHARE * _step(found.q, seed) / fastest
        step = min(max(goal - found.angle, -most), most)
        if step == 0.0:
            return found
        angle = min(max(found.angle + step, found.interval[0]), found.interval[1])
        q = self._in_range(circle.joints(angle, found.branch, seed, self._limits))
        return found if q is None else _Candidate(found.cost, angle, q, found.branch, found.interval)

    def _goal(self, circle: ElbowCircle, found: _Candidate, zero: float) -> float:
        """Returns where on the circle the elbow should be: near to the preference, with margins, not across a limit."""
        low, high = found.interval
        preferred = found.angle + wrapped(self._elbow_preference - zero - found.angle)
        if circle.cosine_of_joint_3(preferred, found.branch) < WOUND:
            preferred = found.angle
        inside = []
        for with_margins in circle.free(found.branch, self._margins):
            for shift in (-TURN, 0.0, TURN):
                a, b = max(with_margins[0] + shift, low), min(with_margins[1] + shift, high)
                if a < b:
                    inside.append((max(a - found.angle, found.angle - b, 0.0), a, b))
        if not inside:
            return (low + high) / 2.0
        _, a, b = min(inside)
        return min(max(preferred, a), b)

    def _bends(self, angle: float) -> bool:
        limits = self._limits
        return limits.lower[3] - JOINT_TOLERANCE_RAD <= angle <= limits.upper[3] + JOINT_TOLERANCE_RAD

    def _in_range(self, q: list[float]) -> list[float] | None:
        """Returns the joints without what rounding put them out of range, None if they are further out."""
        inside = [min(max(a, low), high) for a, low, high in zip(q, self._limits.lower, self._limits.upper)]
        return inside if _step(inside, q) <= JOINT_TOLERANCE_RAD else None


def _elbow_across(u: Vector, q: list[float]) -> Vector:
    """Returns the unit vector across u to the elbow if the axis of joint 4 stays as it is, as far as it can.

    Args:
        u: unit vector from shoulder to wrist.
        q: present joints [rad].
    """
    axis = zyz_axes(q[0], q[1], q[2])[1]
    sign = Branch.of(q).elbow
    for h in ((sign * axis[0], sign * axis[1], sign * axis[2]), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)):
        e = cross(h, u)
        length = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
        if length > 0.1:
            break
    return e[0] / length, e[1] / length, e[2] / length


def _axes_and_position(T: np.ndarray) -> tuple[tuple[Vector, Vector, Vector], Vector]:
    """Returns the columns of a rigid pose.

    Raises:
        ValueError: the pose is not rigid.
    """
    x, y, z, p = map(tuple, T.T[:, :3].tolist())
    xy = cross(x, y)
    faults = (
        abs(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] - 1.0),
        abs(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] - 1.0),
        abs(xy[0] - z[0]),
        abs(xy[1] - z[1]),
        abs(xy[2] - z[2]),
    )
    if max(faults) > RIGID_TOLERANCE:
        raise ValueError(f"the pose {T.tolist()} is not rigid")
    return (x, y, z), p


def _arm_angle(u: Vector, e: Vector) -> float:
    """Returns the angle about u [rad] from the vertical plane above u (from base x where u is vertical) to e."""
    if hypot(u[0], u[1]) < UPRIGHT:
        return atan2(e[1] * u[2], e[0])
    return atan2(e[0] * u[1] - e[1] * u[0], e[2])


def _step(q: Sequence[float], seed: Sequence[float]) -> float:
    return max(abs(a - b) for a, b in zip(q, seed))

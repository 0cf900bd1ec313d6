"""Where the elbow is chosen: of all joints that reach a tool pose, those that continue best from the present ones.

In this order: all joints within their ranges; close to the seed; then a slow return to the preferred arm angle, away
from the ends of the joint ranges and from the singular poses in which joint 2 or joint 6 is zero. An arm that follows a
path keeps its branch, except where joint 2 or 6 is near zero. From rest all eight branches are compared by the time
that the motion takes.

Close means a small weighted joint step in which joint 3 counts most: with it nearly fixed, the elbow stays in its
plane, and the tool may pass over positions in which joint 2 goes through zero without any joint racing. The slow return
adds at most a fraction of the joint step that the tool asks for, so an arm whose tool is at rest does not move."""

from __future__ import annotations

import math
from math import pi, radians
from typing import NamedTuple, Sequence

from iiwa_kinematics.arcs import TURN, Interval, nearest
from iiwa_kinematics.elbow_circle import ALIGNED, BRANCHES, Branch, ElbowCircle, Limits, wrapped
from iiwa_kinematics.robot_model import RobotModel

JOINT_TOLERANCE_RAD = 1e-10  # a joint out of its range by at most this is a rounding error
MARGIN_RAD = radians(5.0)  # the arm angle is led away where a joint is nearer to its limit, or joint 2 or 6 to zero
NEARBY_RAD = radians(3.0)  # a solution with a joint step of at most this is taken without trying others
CROSSING_RAD = radians(10.0)  # a joint that is nearer to zero than this may change its sign along a path


class Candidate(NamedTuple):
    """Joints that reach the pose."""

    cost: float  # squared weighted joint step from the seed
    angle: float  # of the elbow on its circle [rad]
    q: list[float]  # joints, 7 angles [rad]
    branch: Branch  # signs of joints 2, 4 and 6


class ElbowChoice:
    """Chooses branch and arm angle; the elbow slowly returns to the arm angle `preference` [rad]; 0 is up."""

    def __init__(self, model: RobotModel, preference: float) -> None:
        joint_3_weight = 10.0  # how much more a step of joint 3 costs than one of another joint
        self._preference = preference
        self._limits = Limits(model.lower, model.upper)
        self._margins = Limits(model.lower + MARGIN_RAD, model.upper - MARGIN_RAD, MARGIN_RAD)
        self._speeds = model.max_speed.tolist()
        mean = sum(self._speeds) / len(self._speeds)
        self._weights = [(mean / speed) ** 2 for speed in self._speeds]
        self._weights[2] *= joint_3_weight

    def can_bend(self, angle: float) -> bool:
        """Returns whether joint 4 can be at the angle [rad]."""
        low, high = self._limits.lower[3], self._limits.upper[3]
        return low - JOINT_TOLERANCE_RAD <= angle <= high + JOINT_TOLERANCE_RAD

    def continued(self, circle: ElbowCircle, seed: list[float]) -> Candidate | None:
        """Returns the best joints of the seed's branch, or of one that joint 2 or joint 6, near zero, may enter."""
        present = Branch.of(seed)
        best = self._best_in_branch(circle, present, seed)
        if best is not None and _step(best.q, seed) <= NEARBY_RAD:
            return best
        for branch in BRANCHES:
            crossed = [joint for joint, a, b in zip((1, 3, 5), branch, present) if a != b]
            if crossed and 3 not in crossed and all(abs(seed[joint]) < CROSSING_RAD for joint in crossed):
                found = self._best_in_branch(circle, branch, seed)
                if found is not None and (best is None or found.cost < best.cost):
                    best = found
        return best

    def quickest(self, circle: ElbowCircle, seed: list[float]) -> Candidate | None:
        """Returns the joints of all branches to which a motion from rest at the seed takes the least time."""
        present = Branch.of(seed)
        best = self._best_in_branch(circle, present, seed)
        if best is not None and _step(best.q, seed) <= NEARBY_RAD:
            return best
        least = sorted((self._least_time(circle, branch, seed), i) for i, branch in enumerate(BRANCHES))
        fastest = math.inf, 0
        for bound, i in least:
            if bound > fastest[0]:
                break
            found = best if BRANCHES[i] == present else self._best_in_branch(circle, BRANCHES[i], seed)
            if found is not None and (self._time(found.q, seed), i) < fastest:
                quickest, fastest = found, (self._time(found.q, seed), i)
        return None if fastest[0] == math.inf else quickest

    def _least_time(self, circle: ElbowCircle, branch: Branch, seed: list[float]) -> float:
        """Returns a time that a motion from the seed to joints of the branch takes at least [s]."""
        ways = (
            abs(seed[3] - branch.elbow * circle.bend) / self._speeds[3],
            max(-branch.shoulder * seed[1], 0.0) / self._speeds[1],
            max(-branch.wrist * seed[5], 0.0) / self._speeds[5],
        )
        return max(ways)

    def led_back(self, circle: ElbowCircle, found: Candidate, seed: list[float], zero: float) -> Candidate:
        """Returns `found`, led towards the preferred arm angle by a small part of its joint step. `zero` is the arm
        angle at the circle's angle zero [rad]."""
        # fraction of the joint step that may be added for the return to the preferred arm angle
        return_fraction = 0.25
        fastest = max(1.0, max(map(abs, circle.self_motion(found.q))))
        joint_step = _step(found.q, seed)
        most = return_fraction * joint_step / fastest
        if joint_step <= NEARBY_RAD and self._margins.hold(found.q):
            angle = found.angle + min(max(self._preferred(circle, found, zero) - found.angle, -most), most)
            q = found.q if angle == found.angle else circle.joints(angle, found.branch, seed, self._limits)
            if self._margins.hold(q) and Branch.of(q) == found.branch:
                return Candidate(found.cost, angle, q, found.branch)
        low, high = interval = self._interval(circle, found)
        step = min(max(self._goal(circle, found, zero, interval) - found.angle, -most), most)
        if step == 0.0:
            return found
        angle = min(max(found.angle + step, low), high)
        reached = self._in_range(circle.joints(angle, found.branch, seed, self._limits))
        return found if reached is None else Candidate(found.cost, angle, reached, found.branch)

    def _time(self, q: list[float], seed: list[float]) -> float:
        """Returns the time of a motion at full joint speed [s], and more for joints near the ends of their ranges."""
        # how much longer a motion may take to avoid ending with one more joint at its limit, at full speed [s]
        limit_s = 0.1
        rooms = (min(a - low, high - a) for a, low, high in zip(q, self._limits.lower, self._limits.upper))
        near = sum(max(1.0 - room / MARGIN_RAD, 0.0) for room in rooms)
        return max(abs(a - b) / speed for a, b, speed in zip(q, seed, self._speeds)) + limit_s * near

    def _best_in_branch(self, circle: ElbowCircle, branch: Branch, seed: list[float]) -> Candidate | None:
        """Returns the joints of a branch that are cheapest to reach from `seed`, or None if it has none in range."""
        if not self.can_bend(circle.bend * branch.elbow):
            return None
        starts = circle.keeping_joint_3(seed[2], branch) or [0.0 if branch.elbow == Branch.of(seed).elbow else pi]
        # At angle zero the elbow is nearest to the seed's. Mostly the steps from there meet no joint limit.
        best = self._descend(circle, branch, None, min(starts, key=abs), seed, None)
        if best is not None and _step(best.q, seed) <= NEARBY_RAD:
            return best
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
        interval: Interval | None,
        angle: float,
        seed: list[float],
        best: Candidate | None,
    ) -> Candidate | None:
        """Returns the better of `best` and the result of Gauss-Newton steps from `angle` within the interval.
        Without an interval: None if a step leaves the joint ranges."""
        least, found, weights = math.inf if best is None else best.cost, None, self._weights
        for _ in range(3):
            q = self._in_range(circle.joints(angle, branch, seed, self._limits))
            if q is None:
                if interval is None:
                    return None
                break
            cost = 0.0
            for weight, a, b in zip(weights, q, seed):
                cost += weight * (a - b) * (a - b)
            if cost >= least:
                break
            least, found = cost, (angle, q)
            slope = curvature = 0.0
            for weight, m, a, b in zip(weights, circle.self_motion(q), q, seed):
                slope += weight * m * (a - b)
                curvature += weight * m * m
            angle -= slope / curvature
            if interval is not None:
                angle = min(max(angle, interval[0]), interval[1])
        return best if found is None else Candidate(least, *found, branch)

    def _preferred(self, circle: ElbowCircle, found: Candidate, zero: float) -> float:
        """Returns the circle's angle of the preference, or the present one if that would wind joint 3 up [rad]."""
        # Below this cosine of joint 3, the preferred arm angle would need joints 1 and 3 turned over: it is not used.
        wound = -0.5
        preferred = found.angle + wrapped(self._preference - zero - found.angle)
        return found.angle if circle.cosine_of_joint_3(preferred, found.branch) < wound else preferred

    def _interval(self, circle: ElbowCircle, found: Candidate) -> Interval:
        """Returns the angles around that of `found` at which all joints are in their ranges [rad]."""
        for low, high in circle.free(found.branch, self._limits):
            for shift in (-TURN, 0.0, TURN):
                if low + shift - ALIGNED <= found.angle <= high + shift + ALIGNED:
                    return low + shift, high + shift
        return found.angle, found.angle

    def _goal(self, circle: ElbowCircle, found: Candidate, zero: float, interval: Interval) -> float:
        """Returns the circle's angle near the preference that keeps the margins and is not across a limit [rad]."""
        low, high = interval
        inside = []
        for with_margins in circle.free(found.branch, self._margins):
            for shift in (-TURN, 0.0, TURN):
                a, b = max(with_margins[0] + shift, low), min(with_margins[1] + shift, high)
                if a < b:
                    inside.append((max(a - found.angle, found.angle - b, 0.0), a, b))
        if not inside:
            return (low + high) / 2.0
        _, a, b = min(inside)
        return min(max(self._preferred(circle, found, zero), a), b)

    def _in_range(self, q: list[float]) -> list[float] | None:
        """Returns the joints without rounding errors beyond their ranges, None if they are further out."""
        if self._limits.hold(q):
            return q
        inside = [min(max(a, low), high) for a, low, high in zip(q, self._limits.lower, self._limits.upper)]
        return inside if _step(inside, q) <= JOINT_TOLERANCE_RAD else None


def _step(q: Sequence[float], seed: Sequence[float]) -> float:
    return max([abs(a - b) for a, b in zip(q, seed)])

"""The self-motion of the arm: shoulder, wrist and flange stand still, the elbow runs on a circle.

The axes of joints 1 to 3 meet in the shoulder, those of joints 5 to 7 in the wrist; so the target fixes the wrist and
with it the bend of the elbow, and one angle stays free, the angle on the elbow's circle. All axes of the chain are
sinusoids of this angle; the joints follow from them, and so do the angles that each joint limit forbids.

    u: from shoulder to wrist;  e: from the middle of the circle to the elbow;  h = u x e
    beta, alpha: angle between u and upper arm, and between u and forearm

The method is that of Shimizu et al. (IEEE Transactions on Robotics 24, 2008), with the configuration signs of Kuhlemann
et al. (ICCAR 2016) and Faria et al. (Mechanism and Machine Theory 121, 2018). What is different here: the circle is
measured from any reference direction, so no reference plane can degenerate, and the signs only turn joints by half a
turn, so all eight branches share one circle."""

from __future__ import annotations

from math import acos, atan2, copysign, cos, hypot, pi, sin
from typing import Callable, Iterable, NamedTuple, Sequence

import numpy as np

from iiwa_kinematics.arcs import FLAT, TURN, Arc, Interval, intersection, positive, remaining
from iiwa_kinematics.chain import Vector, cross

ALIGNED = 1e-10  # below this sine of joint 2 (or 6) only the sum of joints 1 and 3 (or 5 and 7) matters


class Branch(NamedTuple):
    """The signs of joints 2, 4 and 6, each 1 or -1; a joint at zero keeps the sign of its zero."""

    shoulder: int
    elbow: int
    wrist: int

    @classmethod
    def of(cls, q: Sequence[float] | np.ndarray) -> Branch:
        """Returns the branch that joints q, 7 angles [rad], are in."""
        return cls(int(copysign(1.0, q[1])), int(copysign(1.0, q[3])), int(copysign(1.0, q[5])))


BRANCHES = tuple(Branch(s, e, w) for s in (1, -1) for e in (1, -1) for w in (1, -1))


class Limits:
    """Joint ranges, prepared for the circle.

    Args:
        lower: 7 least joint angles [rad].
        upper: 7 greatest joint angles [rad]; each range is at least half a turn wide for joints 1, 3, 5, 7.
        least_bend: what joints 2 and 6 must be away from zero [rad]."""

    def __init__(self, lower: Iterable[float], upper: Iterable[float], least_bend: float = 0.0) -> None:
        self.lower, self.upper = tuple(map(float, lower)), tuple(map(float, upper))
        self.directions = tuple((cos(a), sin(a), cos(b), sin(b)) for a, b in zip(self.lower, self.upper))
        self.least_bend = least_bend
        self.greatest_cos = cos(least_bend) if least_bend > 0.0 else None

    def hold(self, q: Sequence[float]) -> bool:
        """Returns whether joints q, 7 angles [rad], are within."""
        for angle, low, high in zip(q, self.lower, self.upper):
            if not low <= angle <= high:
                return False
        return not self.least_bend or (abs(q[1]) >= self.least_bend and abs(q[5]) >= self.least_bend)


class ElbowCircle:
    """All ways to reach one target.

    Args:
        bend: absolute angle of joint 4 [rad].
        lengths: of upper arm and forearm [m].
        u: unit vector from the shoulder to the wrist.
        reference: unit vector across u, where the elbow is at angle zero.
        flange: x, y and z axis of the flange at the target."""

    def __init__(
        self,
        bend: float,
        lengths: tuple[float, float],
        u: Vector,
        reference: Vector,
        flange: tuple[Vector, Vector, Vector],
    ) -> None:
        upper_arm, forearm = lengths
        beta = atan2(forearm * sin(bend), upper_arm + forearm * cos(bend))
        self.bend = bend
        self._cb, self._sb = cos(beta), sin(beta)
        self._ca, self._sa = cos(bend - beta), sin(bend - beta)
        self._u, self._v, self._n = u, reference, cross(u, reference)
        # The axes of the flange in the frame (reference, n, u).
        self._flange = tuple(
            tuple(k[0] * a[0] + k[1] * a[1] + k[2] * a[2] for k in (self._v, self._n, u)) for a in flange
        )
        self._forbidden: dict = {}

    def joints(self, angle: float, branch: Branch, near: Sequence[float], limits: Limits) -> list[float]:
        """Returns the 7 joint angles [rad] at an angle on the circle [rad]; they may be out of range. `near`, 7
        joint angles [rad], and the joint ranges decide only where the axes of two joints coincide."""
        c, s = cos(angle), sin(angle)
        shoulder, sign, wrist = branch
        ca, sa, cb, sb = self._ca, self._sa, self._cb, self._sb

        # The axes of the third frame: x and y without their z, which is not needed.
        (ux, uy, uz), (vx, vy, vz), (nx, ny, nz) = self._u, self._v, self._n
        ex, ey = c * vx + s * nx, c * vy + s * ny
        zx, zy = cb * ux + sb * ex, cb * uy + sb * ey
        xx, xy = sign * (cb * ex - sb * ux), sign * (cb * ey - sb * uy)
        yx, yy = sign * (c * nx - s * vx), sign * (c * ny - s * vy)
        across = hypot(zx, zy)
        if across < ALIGNED:
            q1 = _shared_turn(atan2(xy, xx), near[0], limits, 0, 2)
            c1, s1 = cos(q1), sin(q1)
        else:
            c1, s1 = shoulder * zx / across, shoulder * zy / across
            q1 = atan2(s1, c1)
        q2 = atan2(c1 * zx + s1 * zy, cb * uz + sb * (c * vz + s * nz))
        q3 = atan2(c1 * xy - s1 * xx, c1 * yy - s1 * yx)

        # Rows of the rotation from the forearm to the flange, which is Rz(q5) Ry(q6) Rz(q7).
        (x_v, x_n, x_u), (y_v, y_n, y_u), (z_v, z_n, z_u) = self._flange
        z_e = c * z_v + s * z_n
        r00, r01 = sign * (ca * (c * x_v + s * x_n) + sa * x_u), sign * (ca * (c * y_v + s * y_n) + sa * y_u)
        r10, r11 = sign * (c * x_n - s * x_v), sign * (c * y_n - s * y_v)
        r02, r12 = sign * (ca * z_e + sa * z_u), sign * (c * z_n - s * z_v)
        across = hypot(r02, r12)
        if across < ALIGNED:
            q5 = _shared_turn(atan2(r10, r00), near[4], limits, 4, 6)
            c5, s5 = cos(q5), sin(q5)
        else:
            c5, s5 = wrist * r02 / across, wrist * r12 / across
            q5 = atan2(s5, c5)
        q6 = atan2(c5 * r02 + s5 * r12, ca * z_u - sa * z_e)
        q7 = atan2(c5 * r10 - s5 * r00, c5 * r11 - s5 * r01)
        return [q1, q2, q3, sign * self.bend, q5, q6, q7]

    def self_motion(self, q: Sequence[float]) -> list[float]:
        """Returns the derivative of the 7 joints with respect to the angle on the circle, at joints q of this
        circle. Upper arm and forearm turn about u; written in the third and the fourth frame, u is constant."""
        sign = copysign(1.0, q[3])
        s2, s6 = _away_from_zero(sin(q[1])), _away_from_zero(sin(q[5]))
        d1 = sign * self._sb * cos(q[2]) / s2
        d7 = -sign * self._sa * cos(q[4]) / s6
        return [
            d1,
            -sign * self._sb * sin(q[2]),
            self._cb - cos(q[1]) * d1,
            0.0,
            -self._ca - cos(q[5]) * d7,
            sign * self._sa * sin(q[4]),
            d7,
        ]

    def keeping_joint_3(self, q3: float, branch: Branch) -> list[float]:
        """Returns the angles [rad], two at most, at which joint 3 is at `q3` [rad] or, where it cannot be, nearly
        so. With joint 3 held the arm is an ordinary one with six joints, to which joint 2 at zero is no singular
        pose."""
        (ca, cb, cc), (sa, sb, sc) = self._turn_of_joint_3(branch.shoulder * branch.elbow)
        c, s = cos(q3), sin(q3)
        a, b, offset = sa * c - ca * s, sb * c - cb * s, sc * c - cc * s
        amplitude = hypot(a, b)
        if amplitude < FLAT:
            return []
        middle, half = atan2(b, a), acos(min(max(-offset / amplitude, -1.0), 1.0))
        angles = []
        for angle in (middle - half, middle + half):
            x, y = cos(angle), sin(angle)
            if (ca * x + cb * y + cc) * c + (sa * x + sb * y + sc) * s > -ALIGNED:
                angles.append(wrapped(angle))
        return angles

    def cosine_of_joint_3(self, angle: float, branch: Branch) -> float:
        """Returns the cosine of joint 3 at an angle on the circle [rad]; 0 where it is undefined."""
        (ca, cb, cc), (sa, sb, sc) = self._turn_of_joint_3(branch.shoulder * branch.elbow)
        c, s = cos(angle), sin(angle)
        x, y = ca * c + cb * s + cc, sa * c + sb * s + sc
        return x / hypot(x, y) if x else 0.0

    def free(self, branch: Branch, limits: Limits) -> list[Interval]:
        """Returns the intervals of the angle on which all joints but joint 4 are in their ranges."""
        shoulder, elbow, wrist = branch
        return remaining(
            self._part(limits, 0, shoulder, self._joint_1)
            + self._part(limits, 1, shoulder, self._joint_2)
            + self._part(limits, 2, shoulder * elbow, self._joint_3)
            + self._part(limits, 4, wrist * elbow, self._joint_5)
            + self._part(limits, 5, wrist, self._joint_6)
            + self._part(limits, 6, wrist, self._joint_7)
        )

    def _part(self, limits: Limits, joint: int, sign: int, function: Callable[[Limits, int], list[Arc]]) -> list[Arc]:
        key = (limits, joint, sign)
        arcs = self._forbidden.get(key)
        if arcs is None:
            arcs = self._forbidden[key] = function(limits, sign)
        return arcs

    def _joint_1(self, limits: Limits, sign: int) -> list[Arc]:
        k, u, v, n = sign * self._sb, self._u, self._v, self._n
        c = sign * self._cb
        return _outside_turn((k * v[0], k * n[0], c * u[0]), (k * v[1], k * n[1], c * u[1]), limits.directions[0])

    def _joint_2(self, limits: Limits, sign: int) -> list[Arc]:
        cosine = (self._sb * self._v[2], self._sb * self._n[2], self._cb * self._u[2])
        return _outside_bend(cosine, limits, 1, sign)

    def _joint_3(self, limits: Limits, sign: int) -> list[Arc]:
        return _outside_turn(*self._turn_of_joint_3(sign), limits.directions[2])

    def _turn_of_joint_3(self, sign: int) -> tuple[Vector, Vector]:
        """Returns the cosine and the sine of joint 3, both scaled by the absolute sine of joint 2."""
        k, u, v, n = -sign * self._cb, self._u, self._v, self._n
        return (k * v[2], k * n[2], sign * self._sb * u[2]), (sign * n[2], -sign * v[2], 0.0)

    def _joint_5(self, limits: Limits, sign: int) -> list[Arc]:
        k, (v, n, u) = sign * self._ca, self._flange[2]
        return _outside_turn((k * v, k * n, sign * self._sa * u), (sign * n, -sign * v, 0.0), limits.directions[4])

    def _joint_6(self, limits: Limits, sign: int) -> list[Arc]:
        v, n, u = self._flange[2]
        return _outside_bend((-self._sa * v, -self._sa * n, self._ca * u), limits, 5, sign)

    def _joint_7(self, limits: Limits, sign: int) -> list[Arc]:
        k, c = sign * self._sa, sign * self._ca
        (xv, xn, xu), (yv, yn, yu), _ = self._flange
        return _outside_turn((k * xv, k * xn, -c * xu), (-k * yv, -k * yn, c * yu), limits.directions[6])


def _outside_turn(cosine: Vector, sine: Vector, directions: tuple[float, float, float, float]) -> list[Arc]:
    """Returns the arcs on which the joint of this (scaled) cosine and sine is outside its range. The forbidden
    wedge, from the upper limit on to the lower one, is less than half a turn wide; so it is where two sinusoids are
    positive at once."""
    c_low, s_low, c_high, s_high = directions
    (ca, cb, cc), (sa, sb, sc) = cosine, sine
    beyond_high = positive(sa * c_high - ca * s_high, sb * c_high - cb * s_high, sc * c_high - cc * s_high)
    if beyond_high is None:
        return []
    below_low = positive(ca * s_low - sa * c_low, cb * s_low - sb * c_low, cc * s_low - sc * c_low)
    if below_low is None:
        return []
    return intersection(beyond_high, below_low)


def _outside_bend(cosine: Vector, limits: Limits, joint: int, sign: int) -> list[Arc]:
    """Returns the arcs on which the joint with this cosine and this sign is beyond its range, or too near to zero."""
    a, b, c = cosine
    limit = limits.directions[joint][2 if sign > 0 else 0]
    arcs = [positive(-a, -b, limit - c)]
    if limits.greatest_cos is not None:
        arcs.append(positive(a, b, c - limits.greatest_cos))
    return [arc for arc in arcs if arc is not None]


def _shared_turn(total: float, near: float, limits: Limits, first: int, second: int) -> float:
    """Returns the first of two angles whose sum is `total` (mod 2 pi), as near to `near` as both ranges let it."""
    low, high = limits.lower[first] - ALIGNED, limits.upper[first] + ALIGNED
    rest_low, rest_high = limits.lower[second] - ALIGNED, limits.upper[second] + ALIGNED
    ends = (near, limits.lower[first], limits.upper[first], total - limits.lower[second], total - limits.upper[second])
    angles = [wrapped(a) for a in ends]
    allowed = [a for a in angles if low <= a <= high and rest_low <= wrapped(total - a) <= rest_high]
    return min(allowed, key=lambda a: abs(a - near))


def wrapped(angle: float) -> float:
    """Returns the angle in [-pi, pi) [rad]; one that is there already is returned as it is."""
    return angle if -pi <= angle < pi else (angle + pi) % TURN - pi


def _away_from_zero(value: float) -> float:
    return value if abs(value) > ALIGNED else ALIGNED

"""The collision guard: how near the robot is to itself and to what stands around it, and how fast it may come nearer.
It slows the approach of a pair of convex bodies with the distance, ends it SOFT_M before the margin, and leaves the
retreat free.

A pair is measured when it may matter: its distance falls by no more than the joints turn, times how far the body can be
from their axes. The path to a stop is looked at for the goals, and for the arm, whose lag makes it cut corners. A pair
that is nearer than the margin already, because an obstacle has appeared, may only part.

Any failure, also a number that is not finite, raises GuardError: the arm then stops."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import hppfcl
import numpy as np
from ruckig import Trajectory

from iiwa_kinematics import Kinematics
from iiwa_kinematics.chain import Vector, cross, joint_frames, pose_of_axes
from kuka_control.limits.moving_arm import STOPPING, GuardError, approach_speed
from kuka_control.model.obstacles import ConvexBody, ConvexShape
from kuka_control.model.robot_shape import Opening, arm_bodies, hand_bodies, table
from kuka_control.numbers import APPROACH_M_S2, ARM_M, LAG_S, SAMPLED_M, SOFT_M

# What each distance means: table in docs/handbook/collision-guard.md.
GAIN_PER_S = 20.0  # greatest approach speed per distance, near the end of an approach [1/s]
NOISE_M = 1e-6  # error of the library's distances [m]
TOUCHING_M = 1e-9  # bodies whose nearest points are nearer touch [m]
DAMPED = 0.05**2 * np.eye(6)  # of the pseudoinverse, in the tool's speed [m/s], [rad/s]; it matters near singular poses
LINEAR_M = 0.5 * APPROACH_M_S2 / GAIN_PER_S**2  # an approach at v may need v^2 / 2 APPROACH_M_S2 and this [m]
LEAST = 1e-6  # least speed of a correction along its normal, near singular poses
STEP_RAD = 0.063  # of a greater lag the loop may see no more (servo_law.py) [rad]
BRAKING_PER_S = 8.0  # and it is no faster than it can brake before the goal, at so much of its full speed [1/s]


def _guarding(method: Callable) -> Callable:
    """Makes any failure a GuardError."""

    @functools.wraps(method)
    def guarded(self: CollisionGuard, *arguments: Any) -> Any:
        try:
            return method(self, *arguments)
        except Exception as error:
            reason = error if isinstance(error, _NotFinite) else f"{type(error).__name__}: {error}"
            raise GuardError(f"The collision guard failed: {reason}.") from error

    return guarded


class _NotFinite(ValueError):
    """The end of a sentence."""


class NearestPair(NamedTuple):
    """The nearest points of a pair of bodies; the first belongs to the robot."""

    pair: tuple[str, str]
    distance: float  # negative: how deep they overlap [m]
    points: tuple[np.ndarray, np.ndarray]  # shape (3,) each [m]
    normal: Vector  # from the first to the second; where they overlap it still says how they approach
    finger: bool  # whether one of them is a finger

    def __str__(self) -> str:
        return f"the {self.pair[0]} is {1e3 * self.distance:.0f} mm from the {self.pair[1]}"


class PathCheck:
    """The check of one path, a part of it at a time, for any opening of the hand; `fault` is the pair that meets
    on it, None if none has so far."""

    def __init__(self, distances: Iterator[NearestPair | None]) -> None:
        self.done = False
        self.fault: NearestPair | None = None
        self._distances = distances

    @_guarding
    def go_on(self, most: int) -> None:
        """Measures at most so many distances more."""
        measured = 0
        while measured < most and not self.done:
            try:
                self.fault = next(self._distances)
            except StopIteration:
                self.done = True
            measured += 1
            self.done = self.done or self.fault is not None


class CollisionGuard:
    """Pairs of bodies that must keep a distance; for one thread.

    Args:
        ring: whether the marker board's ring is behind the hand.
        obstacles: the bodies around the arm, and what is mounted at its flange.
        margin: the distance that is kept [m].
        allowed: names of obstacles that the fingers may touch.
        opening: of the hand; None: wherever the fingers may come to be.

    Attributes:
        scale: fraction of the last desired velocity that was left, 0 to 1.
        nearest: the nearest pair of those that may have been too fast for it; None if none was."""

    def __init__(
        self,
        kinematics: Kinematics,
        ring: bool,
        obstacles: Iterable[ConvexBody],
        margin: float,
        allowed: Iterable[str] = (),
        opening: Opening | None = None,
    ) -> None:
        self.margin = margin
        self.scale = 1.0
        self.nearest: NearestPair | None = None
        self._kinematics = kinematics
        self._model = kinematics.model
        self._bound = margin + SAMPLED_M
        around = list(obstacles)
        lengths, angles = kinematics.slack
        self._slack = lengths + 1.5 * angles
        self._request = hppfcl.DistanceRequest(True)
        self._result = hppfcl.DistanceResult()
        self._fast: list[float] = self._model.max_speed.tolist()
        self._braking = [2.0 * BRAKING_PER_S * fast for fast in self._fast]
        self._linear = LAG_S**2 * min(self._braking)  # a lag up to which the braking does not count [rad]
        self._q = np.zeros(7)
        self._lag = [0.0] * 7  # how far the arm is behind its goals [rad]
        self._arm = [0.0] * 7  # and so where it is [rad]
        self._measured: np.ndarray | None = None
        arm = [*arm_bodies(self._model, ring), *(body for body in around if body.link)]
        hand = hand_bodies(self._model, ring, opening)
        wide = frozenset((hand[0].name, *(body.name for body in around if body.link)))
        self.bodies = [*arm, *hand, table(), *(body for body in around if not body.link)]
        self._pairs = list(_pairs(self.bodies, len(arm) + len(hand), frozenset(allowed), wide))
        self._reach = np.array([self._reaches(self.bodies[i], self.bodies[j].link) for i, j in self._pairs])
        self._radii = [_farthest(self.bodies[i]) for i, _ in self._pairs]
        self._levers = np.zeros((len(self._pairs), 16))
        for row, pair in zip(self._levers, self._pairs):
            for body in (self.bodies[n] for n in pair):
                row[body.link], row[8 + body.link] = 1.0, _farthest(body)
        self._geometry = [_geometry(body.shape) for body in self.bodies]
        self._local = [_transform(body.T_link_body) for body in self.bodies]
        self._at = _Posture(self._kinematics, self._q.tolist())  # the links at the joints _q
        self._low = np.full(len(self._pairs), -math.inf)  # lower bounds of the distances there [m]

    @_guarding
    def follow(self, goal: Sequence[float], measured: np.ndarray, dt: float) -> None:
        """Follows the arm for the last `dt` [s], in which it had the goal, 7 [rad]. `measured`: joints of the arm,
        shape (7,) [rad], the same object until newer ones come: those before that time."""
        if measured is not self._measured:
            self._measured, self._arm = measured, measured.tolist()
        lag = [ahead - behind for ahead, behind in zip(goal, self._arm)]
        if not math.isfinite(sum(lag)):
            raise _NotFinite(f"the goal is {list(goal)}, and the arm was measured at {measured.tolist()}")
        self._lag = [part * math.exp(-dt / constant) for part, constant in zip(lag, self._time_constants(lag))]
        self._arm = [ahead - part for ahead, part in zip(goal, self._lag)]

    def _time_constants(self, lag: Sequence[float]) -> list[float]:
        """Returns with which time constant each joint works off a lag, 7 [rad], at first; 7 [s]."""
        if max(map(abs, lag)) <= self._linear:
            return [LAG_S] * 7
        ways = zip(map(abs, lag), self._braking)
        return [max(LAG_S, way / math.sqrt(braking * min(way, STEP_RAD) + 1e-12)) for way, braking in ways]

    @_guarding
    def slowed(self, q: Sequence[float], desired: Sequence[float]) -> tuple[list[float], bool]:
        """Returns the joint velocities, 7 [rad/s], with the approach of each pair bounded, and whether one was. A
        hand slides along what is in its way without turning. `q`: joints, 7 [rad]; `desired`: velocities, 7 [rad/s]."""
        sweeps = 5  # passes over the pairs: a correction at one may add speed towards another
        posture, wanted = self._moved_to(q), _finite(desired)
        self.scale, self.nearest = 1.0, None
        end = self.margin + SOFT_M
        fastest = np.minimum(self._reach @ np.abs(wanted), self._levers @ posture.speeds(desired))
        near = (self._low - (0.5 / APPROACH_M_S2) * fastest * fastest < end + LINEAR_M).nonzero()[0].tolist()
        rows = []
        for pair in near:
            most = _speed_at(self._distance(pair, posture) - end)
            if fastest[pair] > most:
                contact = self._contact(pair, posture)
                rows.append((pair, self._approach(pair, contact, posture), contact.normal, most))
                if self.nearest is None or contact.distance < self.nearest.distance:
                    self.nearest = contact
        left: list[float] = wanted.tolist()
        start, corrections = left, {}
        for _ in range(sweeps):
            before = left
            for pair, row, normal, most in rows:
                excess = _dot(row, left) - most
                if excess > LEAST:
                    if pair not in corrections:
                        corrections[pair] = self._correction(pair, row, normal, posture)
                    left = [rate - excess * column for rate, column in zip(left, corrections[pair])]
            if left is before:
                break
        if left is start:
            return left, False
        # Near a singular pose this may need fast joints; none may be faster than in the desired velocity.
        pace, allowed = (max([abs(v) / most for v, most in zip(rates, self._fast)]) for rates in (left, start))
        factor = min(1.0, allowed / max(pace, 1e-12))
        for _, row, _, most in rows:  # between two obstacles the corrections may not agree
            speed = factor * _dot(row, left)
            if speed > most + LEAST:
                factor *= most / speed
        left = [factor * rate for rate in left]
        self.scale = min(max(_dot(left, start) / _dot(start, start), 0.0), 1.0)
        return left, True

    @_guarding
    def near(self, q: Sequence[float], lengths: Sequence[float]) -> list[int]:
        """Returns the pairs, by number, that may come within the margin while the joints turn from q, 7 [rad].
        `lengths`: how far each joint turns at most, 7 [rad]; the arm follows. All other pairs keep the margin."""
        lengths = [max(length, abs(part)) for length, part in zip(lengths, self._lag)]
        posture, drop = self._moved_to(q), self._reach @ _finite(lengths) + (ARM_M - SAMPLED_M)
        pairs = (self._low - drop < self._bound).nonzero()[0].tolist()
        return [pair for pair in pairs if self._distance(pair, posture) - float(drop[pair]) < self._bound]

    @_guarding
    def depths(self, stop: Trajectory, pairs: Sequence[int]) -> dict[int, float]:
        """Returns how far these pairs come within the margin on the path to a stop [m]: only those that do. Of the
        goals and of the arm behind them. `pairs` as `near` returns them; the result is by the same numbers."""
        joints, spares = zip(*self._on_the_way(stop))
        begin = self._moved_to(joints[0])
        turned = np.abs(np.array(joints) - self._q)
        low = np.array([self._distance(pair, begin) for pair in pairs]) - turned @ self._reach[pairs].T
        near, depths = low < self.margin + np.array(spares)[:, None], dict.fromkeys(pairs, 0.0)
        for row, q, spare in zip(near, joints, spares):
            if row.any():
                posture = _Posture(self._kinematics, _finite(q).tolist())
                for pair in itertools.compress(pairs, row):
                    depths[pair] = max(depths[pair], self.margin + spare - self._distance(pair, posture))
        return {pair: depth for pair, depth in depths.items() if depth > 0.0}

    def _on_the_way(self, stop: Trajectory) -> Iterator[tuple[list[float], float]]:
        """Yields joints of the goals on the path to a stop, and of the arm behind them, 7 [rad], and what to spare
        [m]. Between two of these times the goals move on evenly, and the arm as they do plus a rest that decays."""
        before, lag, time = None, self._lag, 0.0
        for fraction in STOPPING:
            now = fraction * stop.duration
            goal: list[float] = stop.at_time(now)[0]
            if before is not None and now > time:
                even = []
                for part, start, end, constant in zip(lag, before, goal, self._time_constants(lag)):
                    steady = constant / (now - time) * (end - start)
                    even.append(steady + math.exp((time - now) / constant) * (part - steady))
                lag = even
            yield goal, SAMPLED_M
            yield [ahead - part for ahead, part in zip(goal, lag)], ARM_M
            before, time = goal, now

    def check(self, path: Sequence[np.ndarray], softly: bool = False) -> PathCheck:
        """Returns the check of a path along joints, shape (7,) each [rad], with all joints in step between two of them.
        A check without a fault holds for the whole path. A pair within the margin at the start may part. `softly`: no
        pair comes where its approach would end."""
        return PathCheck(self._check(path, self._bound + (SOFT_M if softly else 0.0)))

    def _check(self, path: Sequence[np.ndarray], bound: float) -> Iterator[NearestPair | None]:
        """Yields the pair that meets, or None, after each distance and each sample."""
        low, needed = np.full(len(self._pairs), -math.inf), np.full(len(self._pairs), math.inf)
        near = list(range(len(self._pairs)))
        for start, goal in zip(path, path[1:]):
            start, dq, s = _finite(start), _finite(goal) - start, 0.0
            # By the fraction of the way: the fastest approach anywhere, that at the sample, and how fast it can rise.
            fastest = np.maximum(self._reach @ np.abs(dq), 1e-9)
            rise = self._reach @ (np.abs(dq) * (2.0 * np.cumsum(np.abs(dq)) - np.abs(dq)))
            rate = fastest.copy()
            while True:
                posture = _Posture(self._kinematics, (start + s * dq).tolist())
                twists = posture.twists(dq.tolist())
                for pair in near:
                    contact = self._contact(pair, posture)
                    low[pair] = distance = contact.distance
                    rate[pair] = min(fastest[pair], self._closing(pair, contact, twists))
                    if distance < min(needed[pair], bound) - NOISE_M and needed[pair] < math.inf:
                        yield contact
                        return
                    needed[pair] = distance if needed[pair] == math.inf else max(needed[pair], distance)
                    yield None
                if s >= 1.0:
                    break
                step = min(float(np.min(_free(low - bound, rate, rise, fastest), initial=1.0)), 1.0 - s)
                s = 1.0 if s + step > 1.0 - 1e-9 else s + step
                low = low - step * np.minimum(rate + 0.5 * step * rise, fastest)
                rate = np.minimum(rate + step * rise, fastest)
                near = np.flatnonzero((low < bound) | (_free(low - bound, rate, rise, fastest) < 2.0 * step)).tolist()
                yield None

    def _closing(self, pair: int, contact: NearestPair, twists: list[tuple[Vector, Vector]]) -> float:
        """Returns how fast a measured pair closes at most [m/s]; infinity where that is not clear."""
        i, j = self._pairs[pair]
        if self.bodies[j].link or contact.distance < SAMPLED_M:
            return math.inf
        velocity, turn = twists[self.bodies[i].link]
        levered = math.hypot(*cross(contact.normal, turn))
        return max(_dot(contact.normal, velocity) + levered * self._radii[pair], 0.0)

    @_guarding
    def nearest_at(self, q: Sequence[float]) -> NearestPair | None:
        """Returns the nearest pair at the joints q, 7 [rad]; None if there are no pairs."""
        posture = self._moved_to(q)
        nearest, least = None, math.inf
        for pair in np.argsort(self._low).tolist():
            if self._low[pair] >= least:
                break
            distance = self._distance(pair, posture)
            if distance < least:
                nearest, least = pair, distance
        return None if nearest is None else self._contact(nearest, posture)

    def fault_at(self, q: np.ndarray) -> str | None:
        """Returns which bodies the arm may not bring together at the joints q, shape (7,) [rad], a part of a
        sentence. None: it may be there."""
        nearest = self.nearest_at(q.tolist())
        if nearest is None or nearest.distance >= self.margin:
            return None
        robot, other = nearest.pair
        if nearest.distance <= 0.0:
            return f"the {robot} would hit the {other}"
        return f"the {robot} would be {1e3 * nearest.distance:.0f} mm from the {other}, not {1e3 * self.margin:.0f} mm"

    def placed(self, q: Sequence[float]) -> list[tuple[ConvexBody, np.ndarray]]:
        """Returns each body with its pose in the base, shape (4, 4) [m], at the joints q, 7 [rad]."""
        posture = _Posture(self._kinematics, q)
        return [(body, posture.matrix(body.link) @ body.T_link_body) for body in self.bodies]

    def _moved_to(self, q: Sequence[float]) -> _Posture:
        """Returns the links at the joints q, 7 [rad], at which the bounds of the distances hold from now on."""
        if q != self._at.q:
            at = _finite(q)
            self._low -= self._reach @ np.abs(at - self._q)
            self._q, self._at = at, _Posture(self._kinematics, at.tolist())
        return self._at

    def _distance(self, pair: int, posture: _Posture) -> float:
        """Returns the distance of a pair [m]; it is measured once for each posture."""
        distance = posture.distances.get(pair)
        if distance is None:
            i, j = self._pairs[pair]
            self._result.clear()
            at_i = posture.placed(i, self.bodies[i].link, self._local[i])
            at_j = posture.placed(j, self.bodies[j].link, self._local[j])
            found = hppfcl.distance(self._geometry[i], at_i, self._geometry[j], at_j, self._request, self._result)
            if not math.isfinite(found):
                raise _NotFinite(f"the distance of the {self.bodies[i].name} from the {self.bodies[j].name} is {found}")
            distance = posture.distances[pair] = found - self._slack
            if posture is self._at:
                self._low[pair] = distance
        return distance

    def _contact(self, pair: int, posture: _Posture) -> NearestPair:
        posture.distances.pop(pair, None)
        distance = self._distance(pair, posture)
        i, j = self._pairs[pair]
        first, second = self._result.getNearestPoint1(), self._result.getNearestPoint2()
        x, y, z = (second - first).tolist()
        length = math.hypot(x, y, z)
        if length < TOUCHING_M:
            (x, y, z), length = self._result.normal.tolist(), 1.0
        elif distance + self._slack < 0.0:  # they overlap
            length = -length
        return NearestPair(
            (self.bodies[i].name, self.bodies[j].name),
            distance,
            (first, second),
            (x / length, y / length, z / length),
            self.bodies[i].finger or self.bodies[j].finger,
        )

    def _approach(self, pair: int, contact: NearestPair, posture: _Posture) -> list[float]:
        """Returns the speed of the approach per joint speed, 7 [m/rad]."""
        i, j = self._pairs[pair]
        point, row = contact.points[0].tolist(), [0.0] * 7
        before, moment = None, (0.0, 0.0, 0.0)
        for joint in range(self.bodies[j].link, self.bodies[i].link):
            origin = posture.origins[joint]
            if origin is not before:
                before, arm = origin, (point[0] - origin[0], point[1] - origin[1], point[2] - origin[2])
                moment = cross(arm, contact.normal)
            row[joint] = _dot(posture.axes[joint], moment)
        return row

    def _correction(self, pair: int, row: list[float], normal: Vector, posture: _Posture) -> list[float]:
        """Returns the joint velocities, 7 [rad/s], that approach by 1 m/s, to be taken away. In units of each
        joint's speed, so that the strong joints move most."""
        wrist_link = 6  # the first link whose points follow the tool where it does not turn
        i, j = self._pairs[pair]
        if self.bodies[i].link >= wrist_link and self.bodies[j].link == 0:
            if posture.shift is None:
                strong = self._kinematics.jacobian(self._q) * self._model.max_speed
                solved = np.linalg.solve(strong @ strong.T + DAMPED, strong)
                posture.shift = (self._model.max_speed * solved[:3]).T
            column: list[float] = (posture.shift @ normal).tolist()
            speed = _dot(row, column)
            if speed > 0.1:  # of 1 m/s that were asked for
                return [rate / speed for rate in column]
        column = [fast * fast * part for fast, part in zip(self._fast, row)]
        speed = max(_dot(row, column), LEAST)
        return [rate / speed for rate in column]

    def _reaches(self, body: ConvexBody, fixed: int) -> list[float]:
        """Returns how far a body can be from the axes of joints 1 to 7 [m]; 0 where the pair's other body turns too."""
        model = self._model
        local = _farthest(body)
        elbow = model.elbow_wrist + local if body.link > 4 else local
        shoulder = model.shoulder_elbow + elbow if body.link > 2 else elbow
        reach = (shoulder, shoulder, elbow, elbow, local, local, local)
        return [reach[i] if fixed <= i < body.link else 0.0 for i in range(7)]


class _Posture:
    """The links at the joints q, 7 [rad]: axes and points on the axes of joints 1 to 7, and the links' poses."""

    def __init__(self, kinematics: Kinematics, q: Sequence[float]) -> None:
        axes, shoulder, elbow, wrist, _, (x, y, z) = joint_frames(kinematics.model, q)
        self.q = q
        self.axes = axes
        self.distances: dict[int, float] = {}  # of pairs that were measured, by number [m]
        self.shift: np.ndarray | None = None  # joint velocities that shift the tool by 1 m/s, shape (7, 3) [rad/s]
        self.origins = (shoulder, shoulder, shoulder, elbow, wrist, wrist, wrist)
        y3 = (-axes[3][0], -axes[3][1], -axes[3][2])
        self._frames: tuple[tuple[Vector, Vector, Vector], ...] = (
            ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
            (axes[1], axes[0], shoulder),
            (axes[1], axes[2], shoulder),
            (y3, axes[2], elbow),
            (y3, axes[4], elbow),
            (axes[5], axes[4], wrist),
            (axes[5], axes[6], wrist),
            (y, z, wrist),
        )
        self._links: dict[int, hppfcl.Transform3f] = {}
        self._placed: dict[int, hppfcl.Transform3f] = {}

    def speeds(self, v: Sequence[float]) -> list[float]:
        """Returns the speeds of the 8 links' origins [m/s], then those of their turns [rad/s]. `v`: joint
        velocities, 7 [rad/s]."""
        twists = self.twists(v)
        return [math.sqrt(x * x + y * y + z * z) for part in (0, 1) for x, y, z in [twist[part] for twist in twists]]

    def twists(self, v: Sequence[float]) -> list[tuple[Vector, Vector]]:
        """Returns the velocities of the links' origins [m/s] and of their turns [rad/s], of 8 links. `v`: joint
        velocities, 7 [rad/s]."""
        px = py = pz = wx = wy = wz = 0.0
        before = p = (0.0, 0.0, 0.0)
        twists = [(p, p)]
        for link, ((ax, ay, az), rate) in enumerate(zip(self.axes, v), 1):
            origin = self._frames[link][2]
            if link in (3, 5):  # at the elbow and at the wrist another rigid part begins
                x, y, z = origin[0] - before[0], origin[1] - before[1], origin[2] - before[2]
                p = px, py, pz = px + wy * z - wz * y, py + wz * x - wx * z, pz + wx * y - wy * x
            before = origin
            wx, wy, wz = wx + rate * ax, wy + rate * ay, wz + rate * az
            twists.append((p, (wx, wy, wz)))
        return twists

    def matrix(self, link: int) -> np.ndarray:
        """Returns the pose of link 0 to 7 in the base, shape (4, 4) [m]."""
        y, z, p = self._frames[link]
        return pose_of_axes(cross(y, z), y, z, p)

    def placed(self, number: int, link: int, local: hppfcl.Transform3f) -> hppfcl.Transform3f:
        """Returns the pose of the body `number` in the base, which stands at `local` in its link."""
        if link == 0:
            return local
        placed = self._placed.get(number)
        if placed is None:
            if link not in self._links:
                y, z, p = self._frames[link]
                R = np.array((cross(y, z), y, z)).T
                self._links[link] = hppfcl.Transform3f(R, np.array(p))
            placed = self._placed[number] = self._links[link] * local
        return placed


def _pairs(
    bodies: Sequence[ConvexBody], robot: int, allowed: frozenset[str], wide: frozenset[str]
) -> Iterable[tuple[int, int]]:
    """Yields the pairs that may meet; the first `robot` bodies are those of the robot. Of the robot with itself:
    what is beyond the wrist with the base and the upper arm, the forearm with the base, and what is so wide that it
    can reach back over the wrist with the forearm."""
    for i, body in enumerate(bodies[:robot]):
        for j, other in enumerate(bodies):
            if j >= robot:
                meets = body.link > 1 and not (body.finger and other.name in allowed)
            else:
                meets = (body.link >= 6 and other.link <= 3) or (body.link == 5 and other.link <= 1)
                meets = meets or (body.name in wide and other.link in (4, 5))
            if meets:
                yield i, j


def _speed_at(distance: float) -> float:
    """Returns the greatest approach speed [m/s] at a distance from where it ends [m], so that it ends there."""
    return approach_speed(distance, APPROACH_M_S2, GAIN_PER_S)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum([x * y for x, y in zip(a, b)])


def _free(room: np.ndarray, rate: np.ndarray, rise: np.ndarray, fastest: np.ndarray) -> np.ndarray:
    """Returns for how long each pair has room [m] when it closes at a rate that rises up to the fastest."""
    room = np.maximum(room, SAMPLED_M)
    return np.maximum(room / fastest, 2.0 * room / np.maximum(rate + np.sqrt(rate * rate + 2.0 * rise * room), 1e-9))


def _finite(values: Sequence[float] | np.ndarray) -> np.ndarray:
    if len(values) != 7 or not math.isfinite(sum(values)):
        raise _NotFinite(f"it was asked about joints {list(values)}")
    return np.array(values, dtype=float)


def _farthest(body: ConvexBody) -> float:
    """Returns the distance of the farthest point from the link's origin, or more [m]."""
    return float(np.linalg.norm(body.T_link_body[:3, 3])) + body.shape.radius


def _geometry(shape: ConvexShape) -> hppfcl.ShapeBase:
    kinds = {"box": hppfcl.Box, "sphere": hppfcl.Sphere, "cylinder": hppfcl.Cylinder, "capsule": hppfcl.Capsule}
    return kinds[shape.kind](*shape.size)


def _transform(T: np.ndarray) -> hppfcl.Transform3f:
    return hppfcl.Transform3f(np.array(T[:3, :3]), np.array(T[:3, 3]))

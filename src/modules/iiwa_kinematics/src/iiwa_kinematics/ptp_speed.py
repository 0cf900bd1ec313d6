"""The speed of the arm in a point-to-point motion, before it starts, and the velocity that keeps it down. A PTP
motion turns all joints in step along the straight line q(s) = start + s (goal - start), 0 <= s <= 1, and the joint
with the longest way reaches its set speed. So a point p(s) of the arm moves at |p'(s)| ds/dt."""

from __future__ import annotations

import heapq
import math
from typing import Sequence

import numpy as np

from iiwa_kinematics.chain import Ball, fastest_point
from iiwa_kinematics.robot_model import RobotModel

STOP_M_PER_S = 0.8  # above this speed of the tool point the robot's controller stops the arm [m/s]
PTP_M_PER_S = 0.75
"""No PTP motion is planned to be faster [m/s]: the rest up to the stop is for drives that overshoot their plan, and for
the few millimetres by which an arm differs from its data sheet."""
EXCESS = 0.02  # the bound of the path speed exceeds the true maximum by this fraction at most


def path_speed(model: RobotModel, balls: Sequence[Ball], start: np.ndarray, goal: np.ndarray) -> float:
    """Returns a bound of |p'(s)| of the arm's fastest point, at most `EXCESS` above the greatest one [m]. The points
    are elbow, wrist, flange and those in the balls. It searches by intervals: |p''| <= sum_ij |dq_i| |dq_j|
    r_max(i,j), where no point is farther than r_j from axis j, so between two samples |p'| exceeds their mean by at
    most half of that times their distance. `model`: the arm; `balls`: what moves with the flange; `start`, `goal`:
    joints, shape (7,) each [rad]."""
    dq = np.asarray(goal, dtype=float) - start
    bend, rates = _bend(model, balls, np.abs(dq)), dq.tolist()

    def speed(s: float) -> float:
        return fastest_point(model, balls, (start + s * dq).tolist(), rates)

    ends = speed(0.0), speed(1.0)
    best = max(ends)
    intervals = [(-0.5 * (sum(ends) + bend), 0.0, 1.0, *ends)]
    while -intervals[0][0] > (1.0 + EXCESS) * best + 1e-12:
        _, a, b, at_a, at_b = heapq.heappop(intervals)
        middle = 0.5 * (a + b)
        at_middle = speed(middle)
        best = max(best, at_middle)
        for left, right, at_left, at_right in ((a, middle, at_a, at_middle), (middle, b, at_middle, at_b)):
            bound = 0.5 * (at_left + at_right + bend * (right - left))
            heapq.heappush(intervals, (-bound, left, right, at_left, at_right))
    return -intervals[0][0]


def ptp_velocity(
    model: RobotModel,
    balls: Sequence[Ball],
    start: np.ndarray,
    goal: np.ndarray,
    velocity: float,
    limit: float = PTP_M_PER_S,
) -> float:
    """Returns the fraction of the full joint speed for a PTP motion, (0, 1]: `velocity`, or less if need be. At it
    no point of elbow, wrist, flange and balls is faster than `limit` [m/s] on the way from `start` to `goal`, joints
    of shape (7,) each [rad]. A smaller fraction is rounded down to 0.001."""
    allowed = full_speed_time(model, start, goal) * limit
    greatest = velocity * path_speed(model, balls, start, goal)
    return velocity if greatest <= allowed else max(math.floor(1000.0 * velocity * allowed / greatest) / 1000.0, 0.001)


def full_speed_time(model: RobotModel, start: np.ndarray, goal: np.ndarray) -> float:
    """Returns the duration at full joint speed from `start` to `goal`, shape (7,) each [rad], without ramps [s]."""
    return float(np.max(np.abs(np.asarray(goal) - start) / model.max_speed))


def _bend(model: RobotModel, balls: Sequence[Ball], dq: np.ndarray) -> float:
    """Returns the bound of |p''| for the absolute joint steps dq, shape (7,) [rad]."""
    wrist = max([model.wrist_flange, *(math.hypot(x, y, model.wrist_flange + z) + r for x, y, z, r in balls)])
    last = max([0.0, *(math.hypot(x, y) + r for x, y, _, r in balls)])
    elbow = model.elbow_wrist + wrist
    shoulder = model.shoulder_elbow + elbow
    reach = np.array([shoulder, shoulder, elbow, elbow, wrist, wrist, last])
    return float(dq @ reach[np.maximum.outer(np.arange(7), np.arange(7))] @ dq)

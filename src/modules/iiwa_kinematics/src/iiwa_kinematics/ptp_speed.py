"""The speed of tool point and elbow in a point-to-point motion, before it starts, and the velocity that keeps it down.

A PTP motion turns all joints in step along the straight line q(s) = start + s (goal - start), 0 <= s <= 1, and the
joint with the longest way reaches its set speed. So a point p(s) of the arm moves at |p'(s)| ds/dt.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from iiwa_kinematics.chain import jacobian
from iiwa_kinematics.robot_model import RobotModel

STOP_M_PER_S = 0.8  # above this speed of the tool point the robot's controller stops the arm [m/s]
PTP_M_PER_S = 0.75
"""No PTP motion is planned to be faster [m/s]: the rest up to the stop is for drives that overshoot their plan, and for
the few millimetres by which an arm differs from its data sheet."""
EXCESS = 0.02  # the bound of the path speed exceeds the true maximum by this fraction at most


def path_speed(model: RobotModel, T_flange_tool: np.ndarray, start: np.ndarray, goal: np.ndarray) -> float:
    """Returns a bound of |p'(s)| of the tool point and the elbow, at most `EXCESS` above the greatest one [m].

    It searches by intervals: |p''| <= sum_ij |dq_i| |dq_j| r_max(i,j), with the distance r_j of the tool point from
    axis j, so between two samples |p'| exceeds their mean by at most half of that times their distance.

    Args:
        T_flange_tool: shape (4, 4) [m].
        start, goal: joints, shape (7,) each [rad].
    """
    dq = np.asarray(goal, dtype=float) - start
    bend = _bend(model, T_flange_tool, np.abs(dq))

    def speed(s: float) -> float:
        return float(np.linalg.norm(jacobian(model, start + s * dq, T_flange_tool)[:3] @ dq))

    elbow = model.shoulder_elbow * math.hypot(dq[0], dq[1])  # its two axes are at right angles
    ends = speed(0.0), speed(1.0)
    best = max(*ends, elbow)
    intervals = [(-0.5 * (sum(ends) + bend), 0.0, 1.0, *ends)]
    while -intervals[0][0] > (1.0 + EXCESS) * best + 1e-12:
        _, a, b, at_a, at_b = heapq.heappop(intervals)
        middle = 0.5 * (a + b)
        at_middle = speed(middle)
        best = max(best, at_middle)
        for left, right, at_left, at_right in ((a, middle, at_a, at_middle), (middle, b, at_middle, at_b)):
            bound = 0.5 * (at_left + at_right + bend * (right - left))
            heapq.heappush(intervals, (-bound, left, right, at_left, at_right))
    return max(-intervals[0][0], elbow)


def ptp_velocity(
    model: RobotModel,
    T_flange_tool: np.ndarray,
    start: np.ndarray,
    goal: np.ndarray,
    velocity: float,
    limit: float = PTP_M_PER_S,
) -> float:
    """Returns the fraction of the full joint speed for a PTP motion, (0, 1]: `velocity`, or less if need be.

    At it neither the tool point nor the elbow is faster than `limit` [m/s] on the way from `start` to `goal`, joints of
    shape (7,) each [rad]; `T_flange_tool` has the shape (4, 4) [m]. A smaller fraction is rounded down to 0.001.
    """
    allowed = full_speed_time(model, start, goal) * limit
    greatest = velocity * path_speed(model, T_flange_tool, start, goal)
    return velocity if greatest <= allowed else max(math.floor(1000.0 * velocity * allowed / greatest) / 1000.0, 0.001)


def full_speed_time(model: RobotModel, start: np.ndarray, goal: np.ndarray) -> float:
    """Returns the duration at full joint speed from `start` to `goal`, shape (7,) each [rad], without ramps [s]."""
    return float(np.max(np.abs(np.asarray(goal) - start) / model.max_speed))


def _bend(model: RobotModel, T_flange_tool: np.ndarray, dq: np.ndarray) -> float:
    """Returns the bound of |p''| for the absolute joint steps dq, shape (7,) [rad]."""
    x, y, z = T_flange_tool[:3, 3]
    wrist = math.hypot(x, y, model.wrist_flange + z)
    elbow = model.elbow_wrist + wrist
    shoulder = model.shoulder_elbow + elbow
    reach = np.array([shoulder, shoulder, elbow, elbow, wrist, wrist, math.hypot(x, y)])
    return float(dq @ reach[np.maximum.outer(np.arange(7), np.arange(7))] @ dq)

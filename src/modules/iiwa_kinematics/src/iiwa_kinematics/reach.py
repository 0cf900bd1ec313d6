"""At the end of the arm's reach: position first. The tool keeps its position, and its orientation gives way by the
least tilt in the plane through shoulder, wrist and tool point that brings the wrist's distance from the shoulder and
joint 6 into reach; this changes continuously with the desired pose."""

from __future__ import annotations

from math import acos, atan2, cos, radians, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np

from iiwa_kinematics.calibrated import newton_step
from iiwa_kinematics.chain import Vector, cross

if TYPE_CHECKING:
    from iiwa_kinematics.inverse import Kinematics

SCAN_RAD = radians(2.0)  # steps of the tilt between which the end of the reach is sought
LEAST_BEND_RAD = radians(0.5)  # joint 4 keeps this distance to zero: an arm that is bent a little moves on steadily
MARGIN_RAD = radians(0.11)  # and the joints this distance to their limits: a servo goal keeps 0.1 deg
POSITION_M = 1e-7  # the tool is at a position when each coordinate is nearer than this [m]


def tilted(kinematics: Kinematics, T_base_tool: np.ndarray, most: float) -> np.ndarray | None:
    """Returns the pose, shape (4, 4) [m], tilted into the arm's reach by the least angle, at most `most` [rad].
    None: no tilt brings it into reach. Joints 1, 2, 3, 5 and 7 may still be beyond their ranges."""
    bisections = 30  # until the end is known to 2e-9 deg
    model = kinematics.model
    T_base_flange = T_base_tool @ kinematics.T_tool_flange
    z = tuple(T_base_flange[:3, 2].tolist())
    wrist = (T_base_flange[:3, 3] - model.wrist_flange * T_base_flange[:3, 2]).tolist()
    x, y, height = T_base_tool[:3, 3].tolist()
    v = (x, y, height - model.base_shoulder)  # from the shoulder to the tool point
    c = (x - wrist[0], y - wrist[1], height - wrist[2])  # from the wrist to the tool point
    n = cross(c, v)
    length = sqrt(_dot(n, n))
    if length < 1e-9:
        return None
    n = (n[0] / length, n[1] / length, n[2] / length)
    across_c, across_z = cross(n, c), cross(n, z)
    vc, vac, vz, vaz, cz = _dot(v, c), _dot(v, across_c), _dot(v, z), _dot(v, across_z), _dot(c, z)
    squares = _dot(v, v) + _dot(c, c)
    a, b = model.shoulder_elbow, model.elbow_wrist
    straight, folded = a * a + b * b, 2.0 * a * b
    slack_m, slack_rad = kinematics.slack
    farthest = sqrt(straight + folded * cos(LEAST_BEND_RAD)) - slack_m
    nearest = sqrt(straight + folded * cos(float(model.upper[3]) - MARGIN_RAD - slack_rad)) + slack_m
    joint_6 = float(model.upper[5]) - MARGIN_RAD - slack_rad

    def reached(tilt: float) -> bool:
        """Returns whether the wrist is at a distance that the arm reaches, and joint 6 in its range."""
        ct, st = cos(tilt), sin(tilt)
        reach = sqrt(max(squares - 2.0 * (ct * vc + st * vac), 0.0))
        if not nearest <= reach <= farthest:
            return False
        bend = _acos((reach * reach - straight) / folded)
        forearm = bend - atan2(b * sin(bend), a + b * cos(bend))  # its angle to the line from shoulder to wrist
        return _acos((ct * vz + st * vaz - cz) / reach) - forearm <= joint_6

    for i in range(1, int(most / SCAN_RAD) + 1):
        for side in (SCAN_RAD, -SCAN_RAD):
            if reached(i * side):
                out, within = (i - 1) * side, i * side
                for _ in range(bisections):
                    middle = 0.5 * (out + within)
                    out, within = (out, middle) if reached(middle) else (middle, within)
                return _turned(T_base_tool, n, within)
    return None


def approached(
    kinematics: Kinematics, position: np.ndarray, q_seed: np.ndarray, q_goal: np.ndarray, most: np.ndarray
) -> np.ndarray | None:
    """Returns joints on the way from the seed to a goal, shape (7,) [rad], that bring the tool to a position. The
    position has shape (3,) [m]. In the direction of the goal the joints move by `most`, shape (7,) [rad], at most,
    and then by the least that the position asks for. None: they do not get there within their ranges."""
    newton_steps = 5  # two are enough almost everywhere
    lower, upper = kinematics.model.lower + MARGIN_RAD, kinematics.model.upper - MARGIN_RAD
    step = q_goal - q_seed
    q = q_seed + step / max(1.0, float(np.max(np.abs(step) / most)))
    for _ in range(newton_steps):
        error = position - kinematics.forward(q)[:3, 3]
        if np.abs(error).max() <= POSITION_M:
            return q
        q = newton_step(q, kinematics.jacobian(q)[:3], error, lower, upper)
    return None


def _turned(T: np.ndarray, axis: Vector, angle: float) -> np.ndarray:
    """Returns the pose T, shape (4, 4), turned about its origin by an angle [rad] about an axis of the base."""
    n, R, turned = np.array(axis), T[:3, :3], T.copy()
    turned[:3, :3] = (
        cos(angle) * R + sin(angle) * np.cross(n, R, axisb=0, axisc=0) + (1.0 - cos(angle)) * np.outer(n, n @ R)
    )
    return turned


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _acos(cosine: float) -> float:
    return acos(min(max(cosine, -1.0), 1.0))

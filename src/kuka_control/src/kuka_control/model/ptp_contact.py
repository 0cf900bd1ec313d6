"""The external joint torques of a PTP motion that touches nothing, and what is said where the arm touched something.
The robot's controller ends the motion where a torque leaves its range. The toolbox attaches a tool without mass, so
weight and inertia of hand and load count as external, unless the cabinet knows of them: the ranges hold in both
cases."""

from __future__ import annotations

import numpy as np

from common.poses import translation
from iiwa_kinematics import full_speed_time, jacobian
from kuka_control.model.tool_load import GRAVITY, ToolLoad

STEP_RAD = 0.1  # the torques are computed every so often on the way


def torque_ranges(
    load: ToolLoad, start: np.ndarray, goal: np.ndarray, velocity: float, payload: float, margin: float
) -> np.ndarray:
    """Returns the lowest and the highest external torque of each joint, shape (7, 2) [Nm]. `start`, `goal`: joints,
    shape (7,) each [rad]; `velocity`: fraction of the full joint speed; `payload`: mass of what the hand holds [kg];
    `margin`: torque beyond what weight and inertia make [Nm]."""
    # A PTP motion gains this many times the full joint speed in a second at most, whatever its speed: an assumption,
    # as nothing is published of it.
    speed_up_per_s = 5.0
    kinematics, dq = load.kinematics, goal - start
    seconds = max(full_speed_time(kinematics.model, start, goal), 1e-3)
    rate, gain = velocity / seconds, speed_up_per_s / seconds  # of the fraction of the way [1/s], [1/s^2]
    s = np.linspace(0.0, 1.0, int(np.max(np.abs(dq)) / STEP_RAD) + 3)
    masses = (load.mass, translation(*load.center_of_mass)), (payload, kinematics.T_flange_tool)
    totals = np.zeros((2, len(s), 7))  # of weight and inertia, along the way
    for mass, T_flange_mass in masses:
        J = np.array([jacobian(kinematics.model, start + x * dq, T_flange_mass)[:3] for x in s])
        way = J @ dq  # of the mass, per fraction [m]
        bend = np.gradient(way, s, axis=0)
        totals[0] -= mass * GRAVITY * np.einsum("nij,i->nj", J, load.up)
        totals[1] += mass * gain * np.abs(np.einsum("nij,ni->nj", J, way))
        totals[1] += mass * rate**2 * np.abs(np.einsum("nij,ni->nj", J, bend))
    weight, inertia = totals
    low = np.minimum(np.min(weight - inertia, axis=0), 0.0) - margin
    high = np.maximum(np.max(weight + inertia, axis=0), 0.0) + margin
    return np.stack([low, high], axis=1)


def touched(torques: np.ndarray | None, ranges: np.ndarray | None) -> str:
    """Returns which joint bears how much where the arm stands, a part of a sentence. `torques`: external ones, shape
    (7,) [Nm], None: not known; `ranges`: in which the motion continues, shape (7, 2)."""
    if torques is None or ranges is None:
        return "a joint torque left its range; the torques now could not be read"
    beyond = np.maximum(ranges[:, 0] - torques, torques - ranges[:, 1])
    k = int(np.argmax(beyond))
    where = "out of" if beyond[k] > 0.0 else "now again within"
    return f"joint {k + 1} bears {torques[k]:.1f} Nm from outside, {where} {ranges[k, 0]:.1f} to {ranges[k, 1]:.1f} Nm"

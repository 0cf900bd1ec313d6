"""Inverse kinematics: the closed form, and the refined one of a calibrated arm, on poses in reach."""

from __future__ import annotations

import numpy as np

from bench.measure import Goal, Row, number, row, timed
from common.config import parse
from common.poses import translation
from iiwa_kinematics import ROBOTS, Kinematics, kinematics_of, robot_model
from kuka_control.model.config import DhDeviations

FLANGE = "MF_elektrisch"
NEAR_RAD = np.radians(2.0)
GOAL_US = Goal(50.0, 150.0)
TOOL = translation(0.0, 0.0, 0.106)

REFINED = 1e-9
"""What the calibrated arm is brought to: position [m] and rotation by its own kinematics."""

EXACT = 1e-9  # largest error that counts as solved [m], and of the elements of the rotation


def rows(quick: bool) -> list[Row]:
    """Returns time and success of both forms, for both arms."""
    count = 20 if quick else 4_000
    return [row for robot in ROBOTS for row in _closed_rows(robot, count) + _calibrated_rows(robot, count)]


def _closed_rows(robot: str, count: int) -> list[Row]:
    """Returns the time from random and from near seeds, and how many in-limit poses of arm and tool are solved."""
    rng = np.random.default_rng(2)
    arm = Kinematics(robot_model(robot, FLANGE), TOOL)
    lower, upper = arm.model.lower, arm.model.upper
    q = rng.uniform(lower, upper, (count, 7))
    targets = [arm.forward(one) for one in q]
    seeds = {
        "random seed": rng.uniform(lower, upper, (count, 7)),
        "near seed": np.clip(q + rng.uniform(-NEAR_RAD, NEAR_RAD, q.shape), lower, upper),
    }
    table = []
    for name, seed in seeds.items():
        times, results = timed(arm.inverse, zip(targets, seed))
        solved = [
            r.q is not None and np.all((r.q >= lower) & (r.q <= upper)) and np.abs(arm.forward(r.q) - T).max() < EXACT
            for r, T in zip(results, targets)
        ]
        how = f"of {count} random poses with a tool of 0.106 m; within the joints' ranges and to {EXACT:g} m"
        what = f"IK {robot}, {name}"
        table.append(row(what, times, "us", "random poses in reach", GOAL_US))
        table.append(number(f"{what}: solved", 100.0 * np.mean(solved), "%", how, Goal(100.0, at_least=True)))
    return table


def _calibrated_rows(robot: str, count: int) -> list[Row]:
    """Returns time and success of the refined closed form, on the poses and from the seeds of an arm near to them."""
    rng = np.random.default_rng(1)
    off = {name: rng.uniform(-1.0, 1.0, 7) for name in ("delta_a", "delta_alpha", "delta_d", "delta_theta")}
    deviations = parse(DhDeviations, {"robot": robot, "serial": "-", "date": "-", **off})
    arm = kinematics_of(robot_model(robot, FLANGE), np.eye(4), deviations.parameters)
    q = rng.uniform(arm.model.lower, arm.model.upper, (count, 7))
    seeds = np.clip(q + rng.uniform(-NEAR_RAD, NEAR_RAD, q.shape), arm.model.lower, arm.model.upper)
    targets = [arm.forward(one) for one in q]
    times, results = timed(arm.inverse, zip(targets, seeds))
    reached = [r.q is not None and np.abs(arm.forward(r.q) - T).max() < REFINED for r, T in zip(results, targets)]
    what = f"IK {robot}, calibrated"
    how = "random poses in reach, seed within 2 deg a joint; each parameter up to 1 mm, 1 deg off; Python and Pinocchio"
    solved = f"of these; to {REFINED:g}; the others are refused"
    return [row(what, times, "us", how), number(f"{what}: solved", 100.0 * np.mean(reached), "%", solved)]

"""Inverse kinematics: our closed form against numerical solvers, on the same poses in the same run; and refined."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from bench.measure import Row, number, row, timed
from bench.solvers import ITERATIONS, TOLERANCE, DampedLeastSquares, Kdl, arm_model
from common.config import parse
from common.poses import translation
from iiwa_kinematics import ROBOTS, Kinematics, kinematics_of, robot_model
from kuka_control.model.config import DhDeviations

FLANGE = "MF_elektrisch"
NEAR_RAD = np.radians(2.0)
SOLVED = 1e-5
"""A solution is one that brings the flange there to 1e-5 m and 1e-5 rad by the URDF, with all joints in range."""

TOOL = translation(0.0, 0.0, 0.106)

REFINED = 1e-9
"""What the calibrated arm is brought to: position [m] and rotation by its own kinematics."""


def rows(quick: bool) -> list[Row]:
    """Returns time and success of each solver for both arms, with a far and with a near seed."""
    count = 20 if quick else 10_000
    table = []
    for robot in ROBOTS:
        table += _arm_rows(robot, count) + _calibrated_rows(robot, count) + _law_rows(robot, 10 * count)
    return table


def _law_rows(robot: str, count: int) -> list[Row]:
    """Returns how many in-limit poses of arm and tool the closed form solves from random seeds, and how exactly."""
    rng = np.random.default_rng(2)
    arm = Kinematics(robot_model(robot, FLANGE), TOOL)
    solved, worst, outside = 0, 0.0, 0
    for _ in range(count):
        q, seed = rng.uniform(arm.model.lower, arm.model.upper, (2, 7))
        T_base_tool = arm.forward(q)
        found = arm.inverse(T_base_tool, seed).q
        if found is not None:
            solved += 1
            worst = max(worst, float(np.abs(arm.forward(found) - T_base_tool).max()))
            outside += bool(np.any((found < arm.model.lower) | (found > arm.model.upper)))
    what, how = f"IK {robot} law: closed form", f"of {count} random poses with a tool of 0.106 m, seed random"
    return [
        number(f"{what}, solved", 100.0 * solved / count, "%", f"{how}; {outside} of them out of a joint's range"),
        number(f"{what}, largest error", 1e15 * worst, "1e-15", f"{how}; m, and elements of the rotation"),
    ]


def _arm_rows(robot: str, count: int) -> list[Row]:
    rng = np.random.default_rng(0)
    model = arm_model(robot, FLANGE)
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    truth = DampedLeastSquares(model)
    q = rng.uniform(lower, upper, (count, 7))
    targets = [truth.forward(one).copy() for one in q]
    seeds = {
        "cold": rng.uniform(lower, upper, (count, 7)),
        "near": np.clip(q + rng.uniform(-NEAR_RAD, NEAR_RAD, q.shape), lower, upper),
    }
    table = []
    for name, seed in seeds.items():
        settings = f"random poses in reach, seed {'random' if name == 'cold' else 'within 2 deg a joint'}"
        ours = None
        for solver, note, times, found in _solved(robot, model, targets, seed):
            what = f"IK {robot} {name}: {solver}"
            if times is None:
                table.append(Row(what, None, None, "us", note))
                continue
            good = 100.0 * np.mean([_is_solution(truth, *pair) for pair in zip(found, targets)])
            ours = times if ours is None else ours
            ratio = (
                f"; {np.median(times) / np.median(ours):.1f} x the closed form's median" if times is not ours else ""
            )
            table.append(row(what, times, "us", f"{settings}; {note}{ratio}"))
            table.append(number(f"{what}, solved", good, "%", "of these; within 1e-5 m, 1e-5 rad and all joint ranges"))
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
    what = f"IK {robot} near: calibrated arm"
    how = "random poses in reach, seed within 2 deg a joint; each parameter up to 1 mm, 1 deg off; Python and Pinocchio"
    return [
        row(what, times, "us", how),
        number(f"{what}, solved", 100.0 * np.mean(reached), "%", f"of these; to {REFINED:g}; the others are refused"),
    ]


def _solved(robot: str, model: pin.Model, targets: list[pin.SE3], seeds: np.ndarray):
    """Yields for each solver its name, a note, times [us] and joints; None and None where it is not installed."""
    ours = Kinematics(robot_model(robot, FLANGE))
    times, results = timed(ours.inverse, zip([T.homogeneous for T in targets], seeds))
    yield "closed form", "Python", times, [result.q for result in results]

    squares = DampedLeastSquares(model)
    times, found = timed(squares.solve, zip(targets, seeds))
    steps = f"{np.median(squares.iterations):.0f} steps in the median, at most {ITERATIONS}, to {TOLERANCE:g}"
    yield "damped least squares", f"Python on Pinocchio, {steps}", times, found

    names = {"newton_raphson": "KDL NR_JL", "levenberg_marquardt": "KDL LMA"}
    try:
        kdl = Kdl(model)
    except ImportError:
        for name in names.values():
            yield name, "not installed (Debian's python3-pykdl)", None, None
        return
    for method, name in names.items():
        pairs = [(kdl.frame(T), kdl.joints(q)) for T, q in zip(targets, seeds)]
        times, found = timed(getattr(kdl, method), pairs)
        joints = [None if q is None else (np.array(list(q)) + np.pi) % (2 * np.pi) - np.pi for q in found]
        note = f"C++, at most {ITERATIONS} steps, to {TOLERANCE:g}"
        yield name, note if method == "newton_raphson" else f"{note}, knows no joint ranges", times, joints


def _is_solution(truth: DampedLeastSquares, q: np.ndarray | None, target: pin.SE3) -> bool:
    if q is None:
        return False
    error = pin.log6(truth.forward(q).actInv(target))
    within = np.all((q >= truth.lower - 1e-9) & (q <= truth.upper + 1e-9))
    return bool(within and max(np.linalg.norm(error.linear), np.linalg.norm(error.angular)) < SOLVED)

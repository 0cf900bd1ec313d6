"""Inverse kinematics: our closed form beside a numerical solver, on the same poses in the same run; and refined."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from bench.measure import Goal, Peer, Row, number, row, timed
from bench.solvers import DampedLeastSquares, arm_model, peer_of
from common.config import parse
from common.poses import translation
from iiwa_kinematics import ROBOTS, Kinematics, kinematics_of, robot_model
from kuka_control.model.config import DhDeviations

FLANGE = "MF_elektrisch"
NEAR_RAD = np.radians(2.0)
SOLVED = 1e-5
"""A solution is one that brings the flange there to 1e-5 m and 1e-5 rad by the URDF, with all joints in range."""
SOLVED_HOW = "of these; within 1e-5 m, 1e-5 rad and all joint ranges"
GOAL_US = Goal(50.0, 150.0)
TOOL = translation(0.0, 0.0, 0.106)

REFINED = 1e-9
"""What the calibrated arm is brought to: position [m] and rotation by its own kinematics."""

EXACT = 1e-9  # largest error that counts as solved [m], and of the elements of the rotation


def rows(quick: bool) -> list[Row]:
    """Returns time and success of the closed form, for both arms, beside a numerical solver on the same poses."""
    count = 20 if quick else 4_000
    table = []
    for robot in ROBOTS:
        table += _arm_rows(robot, count) + _calibrated_rows(robot, count) + [_law_row(robot, 2 * count)]
    return table


def _law_row(robot: str, count: int) -> Row:
    """Returns how many in-limit poses of arm and tool the closed form solves from random seeds, to EXACT."""
    rng = np.random.default_rng(2)
    arm = Kinematics(robot_model(robot, FLANGE), TOOL)
    solved = 0
    for _ in range(count):
        q, seed = rng.uniform(arm.model.lower, arm.model.upper, (2, 7))
        T_base_tool = arm.forward(q)
        found = arm.inverse(T_base_tool, seed).q
        if found is not None and np.all((found >= arm.model.lower) & (found <= arm.model.upper)):
            solved += np.abs(arm.forward(found) - T_base_tool).max() < EXACT
    how = f"of {count} random poses with a tool of 0.106 m, seed random; within the joints' ranges and to {EXACT:g} m"
    return number(f"IK {robot}: random poses solved", 100.0 * solved / count, "%", how, Goal(100.0, at_least=True))


def _arm_rows(robot: str, count: int) -> list[Row]:
    """Returns time and success on random poses in reach, from random and from near seeds, beside each solver."""
    rng = np.random.default_rng(0)
    model = arm_model(robot, FLANGE)
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    truth = DampedLeastSquares(model)
    q = rng.uniform(lower, upper, (count, 7))
    targets = [truth.forward(one).copy() for one in q]
    seeds = {
        "random seed": rng.uniform(lower, upper, (count, 7)),
        "near seed": np.clip(q + rng.uniform(-NEAR_RAD, NEAR_RAD, q.shape), lower, upper),
    }
    ours, peer = Kinematics(robot_model(robot, FLANGE)), peer_of(model)
    table = []
    for name, seed in seeds.items():
        times, results = timed(ours.inverse, zip([T.homogeneous for T in targets], seed))
        solved = _solved([result.q for result in results], targets, truth)
        peer_times, found = timed(peer.solve, zip(targets, seed))
        of_peer = Peer(peer.name, float(np.median(peer_times))), Peer(peer.name, _solved(found, targets, truth))
        table += [
            row(f"IK {robot}, {name}", times, "us", f"random poses in reach; {peer.how}", GOAL_US, of_peer[0]),
            number(f"IK {robot}, {name}: solved", solved, "%", SOLVED_HOW, Goal(100.0, at_least=True), of_peer[1]),
        ]
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


def _solved(found: list[np.ndarray | None], targets: list[pin.SE3], truth: DampedLeastSquares) -> float:
    """Returns how many of the joints bring the flange to their targets [%]."""
    return 100.0 * float(np.mean([_is_solution(truth, q, target) for q, target in zip(found, targets)]))


def _is_solution(truth: DampedLeastSquares, q: np.ndarray | None, target: pin.SE3) -> bool:
    if q is None:
        return False
    error = pin.log6(truth.forward(q).actInv(target))
    within = np.all((q >= truth.lower - 1e-9) & (q <= truth.upper + 1e-9))
    return bool(within and max(np.linalg.norm(error.linear), np.linalg.norm(error.angular)) < SOLVED)

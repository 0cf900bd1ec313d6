"""The arm's speed in a PTP motion, against finite differences along the path."""

from __future__ import annotations

import numpy as np

from iiwa_kinematics import ROBOTS, arm_points, forward, jacobian, robot_model
from iiwa_kinematics.ptp_speed import EXCESS, PTP_M_PER_S, STOP_M_PER_S, full_speed_time, path_speed, ptp_velocity

CASES = 36
PARTS = 300


def motions(seed, count=CASES):
    """Arms, what their flanges carry, and pairs of joints: far apart, near, and single joints."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        model = robot_model(ROBOTS[i % 2], "MF_elektrisch")
        balls = [
            ((0.0, 0.0, 0.106, 0.0),),
            (),
            tuple((*rng.uniform(-0.2, 0.2, 3).tolist(), rng.choice([0.0, 0.1])) for _ in range(3)),
        ][i % 3]
        start = rng.uniform(model.lower, model.upper)
        goal = [rng.uniform(model.lower, model.upper), start + rng.normal(0.0, 0.1, 7), start][i // 3 % 3].copy()
        if i // 3 % 3 == 2:
            j = rng.integers(7)
            goal[j] = rng.uniform(model.lower[j], model.upper[j])
        yield model, balls, start, np.clip(goal, model.lower, model.upper)


def sampled(model, balls, start, goal):
    """The greatest |p'(s)| of elbow, wrist, flange and balls, by differences along the path."""
    points, turns = [], []
    for s in np.linspace(0.0, 1.0, PARTS + 1):
        q = start + s * (goal - start)
        T = forward(model, q)
        points.append([*arm_points(model, q)[2:], *((T @ [*ball[:3], 1.0])[:3] for ball in balls)])
        turns.append(np.linalg.norm(jacobian(model, q)[3:] @ (goal - start)))
    speeds = PARTS * np.linalg.norm(np.diff(np.array(points), axis=0), axis=2)
    radii = np.array([0.0, 0.0, 0.0, *(ball[3] for ball in balls)])
    return float(np.max(speeds + np.minimum(turns[1:], turns[:-1])[:, None] * radii))


def test_the_bound_is_above_the_path_and_near_it():
    for case in motions(1):
        bound, true = path_speed(*case), sampled(*case)
        assert true <= bound + 1e-9
        assert bound <= (1.0 + EXCESS) * 1.02 * true + 1e-9


def test_no_motion_passes_the_limit_and_none_is_slowed_for_nothing():
    for case in motions(2):
        model, _, start, goal = case
        fastest, shortest = sampled(*case), full_speed_time(model, start, goal)
        for velocity in (0.05, 0.25, 1.0):
            used = ptp_velocity(*case, velocity)
            assert 0.0 < used <= velocity
            if not np.array_equal(start, goal):
                assert used * fastest / shortest <= PTP_M_PER_S
                least = (PTP_M_PER_S - 0.001 / used) * (1.0 - 2.0 * EXCESS)
                assert used == velocity or used * fastest / shortest > least


def test_where_the_arm_is_already_any_velocity_is_allowed():
    model = robot_model(ROBOTS[0], "MF_elektrisch")
    assert ptp_velocity(model, (), np.ones(7), np.ones(7), 1.0) == 1.0


def test_the_limit_is_below_the_stop():
    assert PTP_M_PER_S < 0.95 * STOP_M_PER_S

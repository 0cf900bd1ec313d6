"""The arm that does not follow is found out, the arm that follows is left in peace."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kuka_control.tracking import TrackingMonitor

DT = 0.004


def run(goals, arm, dt=DT):
    """Returns (time, fault) of the first verdict, or None; `arm` is the next measured joint from measured and goal."""
    monitor, measured = TrackingMonitor(), np.zeros(7)
    for i, goal in enumerate(goals):
        fault = monitor.step(goal, measured, i * dt)
        if fault:
            return i * dt, fault
        measured = arm(measured, goal)
    return None


def sweep(speed, seconds):
    return [np.full(7, speed * DT * i) for i in range(int(seconds / DT))]


@settings(max_examples=30)
@given(st.floats(-1.5, 1.5), st.floats(0.02, 0.1))
def test_an_arm_that_lags_by_its_servo_is_fine(speed, lag):
    assert run(sweep(speed, 1.5), lambda q, goal: q + (goal - q) * DT / lag) is None


def test_an_arm_at_rest_at_its_goal_is_fine():
    assert run([np.full(7, 0.004)] * 1000, lambda q, goal: q) is None


@settings(max_examples=30)
@given(st.floats(0.1, 1.5))
def test_a_frozen_arm_is_found_within_half_a_second_of_moving_away(speed):
    time, fault = run(sweep(speed, 3.0), lambda q, goal: q)
    assert time - np.radians(0.5) / speed < 0.5
    assert "stands still" in fault


def test_an_arm_far_behind_is_found():
    time, fault = run([np.full(7, 1.0)] * 200, lambda q, goal: q + 1e-3)
    assert time < 0.5 and "behind" in fault


def test_a_stall_of_the_loop_is_not_blamed_on_the_arm():
    monitor = TrackingMonitor()
    goal = np.full(7, 0.05)
    assert monitor.step(goal, np.zeros(7), 0.0) is None
    assert monitor.step(goal, np.zeros(7), 2.0) is None

"""The arm that does not follow or is held on its way is found out, the arm that moves is left in peace."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kuka_control.loop.tracking import PtpSupervision, TrackingMonitor
from rig_simulation.devices.sunrise.paths import JointMove

DT = 0.004


def run(goals, arm, dt=DT):
    """Returns (time, fault) of the first verdict, or None; `arm` is the next measured joint from measured and goal."""
    monitor, measured = TrackingMonitor(), np.zeros(7)
    for i, goal in enumerate(goals):
        fault = monitor.step(goal, measured, i * dt)
        if fault:
            return i * dt, fault
        measured = np.array(arm(measured, goal))  # a new reading
    return None


def sweep(speed, seconds):
    return [np.full(7, speed * DT * i) for i in range(int(seconds / DT))]


@settings(max_examples=30)
@given(st.floats(-1.5, 1.5), st.floats(0.02, 0.1))
def test_an_arm_that_lags_by_its_servo_is_fine(speed, lag):
    assert run(sweep(speed, 1.5), lambda q, goal: q + (goal - q) * DT / lag) is None


@settings(max_examples=30)
@given(st.floats(0.1, 1.5))
def test_a_frozen_arm_is_found_within_half_a_second_of_moving_away(speed):
    time, fault = run(sweep(speed, 3.0), lambda q, goal: q)
    assert time - np.radians(0.5) / speed < 0.5
    assert "stands still" in fault


def test_an_arm_of_which_nothing_new_is_known_is_not_blamed():
    monitor, measured = TrackingMonitor(), np.zeros(7)
    for i in range(100):
        assert monitor.step(np.full(7, 0.05), measured, i * DT) is None


@settings(max_examples=30)
@given(st.floats(0.1, 1.5), st.sampled_from([DT, 0.02, 0.2]))
def test_goals_do_not_move_on_without_measured_joints(speed, dt):
    monitor, measured = TrackingMonitor(), np.zeros(7)
    cycles = next(i for i in range(10_000) if monitor.step(np.full(7, speed * DT * i), measured, i * dt))
    assert (cycles - np.radians(0.5) / (speed * DT)) * min(dt, 0.03) < 0.6
    assert monitor.step(np.zeros(7), np.zeros(7), 10_000.0) is None, "new joints, at the goal"


def test_a_stall_of_the_loop_is_not_blamed_on_the_arm():
    monitor = TrackingMonitor()
    goal = np.full(7, 0.05)
    assert monitor.step(goal, np.zeros(7), 0.0) is None
    assert monitor.step(goal, np.zeros(7), 2.0) is None


START, END = np.radians([10.0, 0.0, 0.0, -20.0, 0.0, 5.0, 0.0]), np.radians([-40.0, 30.0, 0.0, -80.0, 0.0, 75.0, 1.0])
SPEED, ACCELERATION = np.full(7, 0.25), np.full(7, 3.0)


def watch(end, joints, seconds):
    """Returns when a motion counts as held for the first time, or None; `joints` is a function of time [s]."""
    supervision = PtpSupervision("home", end)
    for i in range(int(seconds / DT)):
        event = supervision.step(np.array(joints(i * DT)), i * DT)
        assert supervision.held == supervision.was_held == (event is not None)
        if supervision.held:
            assert event.level == "error" and "home" in event.sentence
            return i * DT
    return None


@settings(max_examples=30)
@given(st.floats(0.05, 1.0), st.floats(0.0, 0.3), st.floats(0.01, 1.0))
def test_a_motion_at_any_override_is_left_in_peace(override, latency, share):
    move = JointMove(START, START + share * (END - START), SPEED, ACCELERATION)
    seconds = latency + move.duration / override + 0.3
    assert watch(move.at(move.duration), lambda t: move.at(override * (t - latency)), seconds) is None


@settings(max_examples=30)
@given(st.floats(0.1, 1.0), st.floats(0.1, 0.95), st.floats(0.0, np.radians(0.05)))
def test_an_arm_that_is_held_on_its_way_is_found_within_half_a_second(override, share, give):
    """A little later if somebody leans on it, so that its joints give."""
    move = JointMove(START, END, SPEED, ACCELERATION)
    held_at = share * move.duration / override

    def joints(t):
        return move.at(override * min(t, held_at)) + give * np.sin(6.0 * max(t - held_at, 0.0))

    found = watch(END, joints, held_at + 2.0) - held_at
    assert 0.0 < found < (0.5 if give == 0.0 else 1.3)


def test_joints_that_are_not_read_anew_say_nothing_of_a_motion():
    supervision = PtpSupervision("home", END)
    supervision.step(START, 0.0)
    still = START + 0.1 * (END - START)
    assert not any(supervision.step(still, 0.1 * i) for i in range(1, 40))
    assert supervision.step(START + 0.2 * (END - START), 4.0) is None and not supervision.was_held


def test_an_arm_that_is_free_again_is_reported_once_and_it_stays_known_that_it_was_held():
    supervision = PtpSupervision("home", END)
    held = [supervision.step(np.array(START), DT * i) for i in range(300)]
    free = [supervision.step(START + (0.1 + 1e-3 * i) * (END - START), 2.0 + DT * i) for i in range(100)]
    assert [event.level for event in held + free if event] == ["error", "info"]
    assert supervision.was_held and not supervision.held and supervision.still == 0.0

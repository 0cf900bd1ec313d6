"""Supervision of PTP motions: its decisions, and its loop with a client whose answers a test chooses."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kst.errors import ConnectionLost, MotionRefused, PtpFailed, ReplyTimeout, UnexpectedReply
from kst.ptp import PtpLimits, PtpState, PtpSupervisor
from kst.ptp_client import read_joints, run_ptp

joints = arrays(float, 7, elements=st.floats(-2.0, 2.0))
ZERO, BENT = np.zeros(7), np.radians([0.0, 20.0, 10.0, -110.0, 0.0, 90.0, -45.0])
LIMITS = PtpLimits()
QUICK = PtpLimits(period=0.0)


@given(joints, joints, st.floats(0.0, 1.0))
def test_on_a_straight_path_the_fraction_is_that_of_the_path(start, goal, part):
    step = np.max(np.abs(goal - start))
    progress = PtpSupervisor(start, goal, 0.0).observe(start + part * (goal - start), 1.0)
    if step > 0.01:
        assert progress.fraction == pytest.approx(part, abs=1e-6)
    assert progress.remaining == pytest.approx((1.0 - part) * step, abs=1e-6)


@given(joints, joints, joints)
def test_a_fraction_is_never_outside_0_and_1(start, goal, q):
    progress = PtpSupervisor(start, goal, 0.0).observe(q, 1.0)
    assert 0.0 <= progress.fraction <= 1.0 and progress.remaining >= 0.0
    assert progress.joint == 1 + np.argmax(np.abs(goal - q))


def test_a_stall_begins_once_and_ends_with_the_next_motion():
    supervisor = PtpSupervisor(ZERO, BENT, 0.0)
    times = (0.5 * LIMITS.stalled, LIMITS.stalled, LIMITS.stalled + 0.1)
    before, begin, after = (supervisor.observe(ZERO, t) for t in times)
    assert [p.state for p in (before, begin, after)] == [PtpState.MOVING, PtpState.STALLED, PtpState.STALLED]
    assert [p.stall_began for p in (before, begin, after)] == [False, True, False]
    now = times[-1] + 0.1
    assert supervisor.observe(0.1 * BENT, now).state is PtpState.MOVING
    assert supervisor.observe(0.1 * BENT, now + LIMITS.stalled).stall_began
    end = supervisor.observe(0.1 * BENT, now + LIMITS.given_up)
    assert (end.state, end.still) == (PtpState.GIVEN_UP, pytest.approx(LIMITS.given_up))


def test_slow_motion_is_motion():
    supervisor = PtpSupervisor(ZERO, BENT, 0.0)
    states = {supervisor.observe(t * 1e-4 * BENT, t).state for t in np.arange(0.0, 60.0, 0.1)}
    assert states == {PtpState.MOVING}


@pytest.mark.parametrize(
    ("off", "expected"), [(0.99, PtpState.ARRIVED), (1.01, PtpState.SHORT), (-1.01, PtpState.SHORT)]
)
def test_the_reported_end_is_an_arrival_only_at_the_goal(off, expected):
    q = BENT + off * LIMITS.arrived * np.eye(7)[2]
    progress = PtpSupervisor(ZERO, BENT, 0.0).observe(q, 1e6, arrived=True, interrupted=True)
    assert progress.state is expected


def test_interruption_and_time_out():
    supervisor = PtpSupervisor(ZERO, BENT, 10.0, PtpLimits(timeout=2.0))
    assert supervisor.observe(ZERO, 11.9).state is PtpState.MOVING
    assert supervisor.observe(ZERO, 12.0).state is PtpState.TIMED_OUT
    assert supervisor.observe(ZERO, 12.0, interrupted=True).state is PtpState.INTERRUPTED


def test_only_missed_readings_in_a_row_are_too_many():
    supervisor = PtpSupervisor(ZERO, BENT, 0.0)
    assert not any(supervisor.miss() for _ in range(LIMITS.missed - 1))
    supervisor.observe(ZERO, 1.0)
    assert [supervisor.miss() for _ in range(LIMITS.missed)] == [False] * (LIMITS.missed - 1) + [True]


class Arm:
    """Stands for the client: answers of the joints and of the end of the motion, each a value or an error; the last
    one again and again."""

    def __init__(self, joints, ends):
        self.calls, self.now = [], 0.0
        self._joints, self._ends = deque(joints), deque(ends)

    def monotonic(self):
        return self.now

    def pause(self, duration):
        self.now += duration

    def joints(self):
        return self._next(self._joints)

    def ptp_arrived(self):
        self.calls.append("arrived")
        return self._next(self._ends)

    def start_ptp_joints(self, q, velocity):
        self.calls.append(("start", tuple(q), velocity))

    @staticmethod
    def _next(answers):
        answer = answers.popleft() if len(answers) > 1 else answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer


LATE, NAN = ReplyTimeout("late", command="getJointsPositions"), UnexpectedReply("NaN", reply="NaN_")


def test_a_motion_with_its_reports():
    arm = Arm([ZERO, 0.5 * BENT, BENT], [False, True])
    reports = []
    end = run_ptp(arm, BENT, 0.3, QUICK, lambda progress, q: reports.append((progress.fraction, q)))
    assert end.state is PtpState.ARRIVED
    assert arm.calls == [("start", tuple(BENT), 0.3), "arrived", "arrived"]
    np.testing.assert_allclose([fraction for fraction, _ in reports], [0.5, 1.0])
    np.testing.assert_array_equal(reports[0][1], 0.5 * BENT)


def test_readings_are_a_period_apart_until_the_link_is_aborted():
    arm = Arm([ZERO, ZERO, 0.5 * BENT, BENT], [False, False, True])
    assert run_ptp(arm, BENT, 0.3, PtpLimits(period=0.1)).state is PtpState.ARRIVED
    assert arm.now == pytest.approx(0.2)

    def aborted(duration):
        raise ConnectionLost("aborted")

    arm = Arm([ZERO], [False])
    arm.pause = aborted
    with pytest.raises(ConnectionLost):
        run_ptp(arm, BENT, 0.3, QUICK)


@pytest.mark.parametrize("bad", [LATE, NAN])
def test_single_bad_readings_do_not_end_a_motion(bad):
    arm = Arm([bad, bad, ZERO, bad, bad, bad, 0.5 * BENT, bad, BENT], [False, False, bad, False, False, True])
    assert run_ptp(arm, BENT, 0.3, QUICK).state is PtpState.ARRIVED


@pytest.mark.parametrize("bad", [LATE, NAN])
def test_a_bad_reading_after_the_reported_end_does_not_ask_for_the_end_again(bad):
    arm = Arm([ZERO, bad, BENT], [True, AssertionError("asked again")])
    assert run_ptp(arm, BENT, 0.3, QUICK).state is PtpState.ARRIVED


@pytest.mark.parametrize("bad", [LATE, NAN])
def test_too_many_bad_readings_in_a_row_are_the_error(bad):
    with pytest.raises(type(bad)):
        run_ptp(Arm([ZERO, bad], [False]), BENT, 0.3, QUICK)
    with pytest.raises(type(bad)):
        read_joints(Arm([bad] * LIMITS.missed + [ZERO], [False]))
    np.testing.assert_array_equal(read_joints(Arm([bad] * (LIMITS.missed - 1) + [ZERO], [False])), ZERO)


@pytest.mark.parametrize(
    ("limits", "ends", "state"),
    [
        ({"given_up": 0.0}, [False], PtpState.GIVEN_UP),
        ({"timeout": 0.0}, [False], PtpState.TIMED_OUT),
        ({}, [True], PtpState.SHORT),
    ],
)
def test_failures_carry_the_last_progress(limits, ends, state):
    with pytest.raises(PtpFailed) as caught:
        run_ptp(Arm([ZERO], ends), BENT, 0.3, PtpLimits(period=0.0, **limits))
    assert (caught.value.progress.state, caught.value.progress.joint) == (state, 4)
    assert math.degrees(caught.value.progress.remaining) == pytest.approx(110.0)


def test_interruption_returns_and_refusal_passes():
    end = run_ptp(Arm([ZERO], [False]), BENT, 0.3, QUICK, interrupted=lambda: True)
    assert end.state is PtpState.INTERRUPTED
    end = run_ptp(Arm([0.5 * BENT, LATE], [False]), BENT, 0.3, QUICK, interrupted=lambda: True)
    assert end.state is PtpState.INTERRUPTED and math.degrees(end.remaining) == pytest.approx(55.0)
    with pytest.raises(MotionRefused):
        run_ptp(Arm([ZERO], [MotionRefused("limit")]), BENT, 0.3, QUICK)

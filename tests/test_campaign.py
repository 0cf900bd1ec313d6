"""The campaign's judge can fail: traces of right reactions pass, those of wrong ones do not. And its page and rows."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from campaign import page
from campaign.judge import FULL_SPEED, Evidence, Expected, judge

FAULT = 100.0
BRAKES = 8.0 * FULL_SPEED / FULL_SPEED[0]  # rad/s^2


def arm(*parts, speed=0.3, until=8.0):
    """Returns the steps of an arm whose joints move at `speed` [rad/s] before the fault, and then do what `parts` say.

    A part is (duration [s], acceleration [rad/s^2] of joint 1, in proportion for the others); at last they stand.
    """
    v, steps, t, q = speed, [], FAULT - 0.5, np.zeros(7)
    scale = FULL_SPEED / FULL_SPEED[0]
    for duration, acceleration in ((0.5, 0.0), *parts):
        for _ in range(round(duration / 1e-3)):
            v += acceleration * 1e-3
            q = q + v * scale * 1e-3
            t += 1e-3
            steps.append([t, *q, *(v * scale), abs(v)])
    while t < FAULT + until:
        t += 0.1
        steps.append([t, *q, *np.zeros(7), 0.0])
    return np.array(steps)


def stops(rate=8.0, speed=0.3, delay=0.0):
    return arm((delay, 0.0), (speed / rate, -rate), speed=speed)


def statuses(*changes):
    """Returns a status every 0.1 s; `changes`: (time after the fault [s], mode)."""
    found = []
    for t in np.arange(-0.5, 8.0, 0.1):
        mode = [m for when, m in ((-1.0, "servo"), *changes) if when <= t][-1]
        found.append((FAULT + t, mode, mode != "stopped"))
    return found


def seen(**fields):
    return Evidence(**{"steps": stops(), "fault": FAULT, "end": FAULT + 8.0, **fields})


def verdict(expected, **fields):
    return judge(expected, seen(**fields))


class TestHold:
    expected = Expected("H", within=0.5)

    def test_an_arm_that_brakes_holds(self):
        found = verdict(self.expected)
        assert found.result == "passed" and found.reaction_s == pytest.approx(0.0375, abs=2e-3)
        assert found.joint_acceleration == pytest.approx(8.0, rel=0.01)

    @pytest.mark.parametrize(
        ("steps", "fault"),
        [
            (stops(delay=0.8), "only after"),
            (arm((6.0, 0.0)), "did not come to rest"),
            (stops(rate=40.0), "acceleration"),
            (arm((0.2, 4.0), (0.275, -4.0), speed=0.3), "tool speed"),
            (arm((0.1, 14.0), (0.17, -10.0)), "joint speed"),
        ],
        ids=["late", "never", "too hard", "speeds up", "at full speed"],
    )
    def test_one_that_does_otherwise_fails(self, steps, fault):
        found = verdict(self.expected, steps=steps, mended=FAULT + 3.0)
        assert found.result == "failed" and any(fault in text for text in found.faults)

    def test_a_machine_that_paused_cannot_judge_the_time(self):
        late = stops(delay=0.8)
        assert verdict(self.expected, steps=late, pauses=[(FAULT + 0.6, 0.5)]).result == "slow"
        assert verdict(self.expected, steps=late, pauses=[(FAULT + 5.0, 0.5)]).result == "failed"
        hard = verdict(self.expected, steps=stops(rate=40.0), pauses=[(FAULT + 0.1, 0.5)])
        assert hard.result == "failed", "a pause excuses no acceleration"


class TestDisengage:
    expected = Expected("D", within=1.0, operator=True)

    def test_leaving_for_home_passes(self):
        found = verdict(self.expected, statuses=statuses((0.4, "returning"), (3.0, "home")))
        assert found.result == "passed" and found.reaction_s == pytest.approx(0.4, abs=0.11)

    @pytest.mark.parametrize(
        ("changes", "fault"),
        [
            ([], "never left servo mode"),
            ([(2.0, "home")], "only after"),
            ([(0.4, "home"), (2.0, "pick_up")], "without the operator"),
            ([(0.4, "stopped"), (2.0, "servo")], "without the operator"),
        ],
    )
    def test_otherwise_fails(self, changes, fault):
        found = verdict(self.expected, statuses=statuses(*changes))
        assert found.result == "failed" and any(fault in text for text in found.faults)

    def test_the_operator_may_engage_again(self):
        changes = statuses((0.4, "home"), (4.0, "servo"))
        assert verdict(self.expected, statuses=changes, operator=FAULT + 3.0).result == "passed"


class TestLatch:
    expected = Expected("L", within=1.0)

    def test_stopped_until_the_operator_acts(self):
        changes = statuses((0.4, "stopped"), (4.0, "homing"))
        assert verdict(self.expected, statuses=changes, operator=FAULT + 3.5).result == "passed"

    @pytest.mark.parametrize(
        ("changes", "steps", "fault"),
        [
            ([(0.4, "home")], stops(), "never `stopped`"),
            ([(0.4, "stopped"), (2.0, "homing")], stops(), "opened without the operator"),
            ([(0.4, "stopped")], arm((0.0375, -8.0), (2.0, 0.0), (0.1, 2.0), (0.1, -2.0)), "moved by"),
        ],
    )
    def test_otherwise_fails(self, changes, steps, fault):
        found = verdict(self.expected, statuses=statuses(*changes), steps=steps)
        assert found.result == "failed" and any(fault in text for text in found.faults)


class TestRefuse:
    expected = Expected("R", within=1.0, named_by="not finite", still=True)
    said = ((FAULT + 0.2, "rosout", "The frame is refused: it is not finite."),)

    def test_with_the_reason_and_without_a_motion_passes(self):
        found = verdict(self.expected, steps=arm(speed=0.0), said=self.said)
        assert found.result == "passed" and "not finite" in found.named

    @pytest.mark.parametrize(
        ("steps", "said", "fault"),
        [
            (arm(speed=0.0), [], "nothing was refused"),
            (arm(speed=0.0), [(FAULT - 1.0, "rosout", "it is not finite")], "no message named it"),
            (arm((0.1, 0.1), (0.1, -0.1), speed=0.0), said, ""),
            (arm((0.3, 0.5), (0.3, -0.5), speed=0.0), said, "moved by"),
        ],
    )
    def test_otherwise_fails(self, steps, said, fault):
        found = verdict(self.expected, steps=steps, said=said)
        assert (found.result == "failed") == bool(fault) and (not fault or any(fault in t for t in found.faults))


def test_servo_mode_is_left_by_its_command():
    expected = Expected("S", within=1.0)
    assert verdict(expected, events=[(FAULT + 0.3, "received stopDirectServoJoints")]).result == "passed"
    assert verdict(expected, events=[(FAULT - 0.3, "received stopDirectServoJoints")]).result == "failed"


def test_deaths_and_the_conditions_of_a_row_fail_it():
    expected = Expected("H", within=0.5)
    assert verdict(expected, died=["/leap_driver"]).faults == ["died: /leap_driver"]
    assert verdict(expected, checks=[("the hand opens", False, "0.3 rad")]).faults == ["the hand opens: 0.3 rad"]
    assert verdict(expected, checks=[("the hand opens", True, "")]).result == "passed"


def test_the_worst_of_several_joints_counts():
    steps = stops()
    steps[600:640, 8 + 6] = 0.97 * FULL_SPEED[6]
    assert any("joint speed" in text for text in verdict(Expected("", 1.0), steps=steps).faults)


ros = pytest.mark.ros


@ros
class TestRows:
    def test_the_page_is_that_of_the_stored_results(self):
        from campaign import run

        results = json.loads(run.RESULTS.read_text())
        assert run.PAGE.read_text() == page.page(run.rows.load(), results)
        assert run.RESULTS.read_text() == page.as_json(results)

    def test_rows_are_chosen_by_numbers_ranges_and_danger(self):
        from campaign import run

        entries = run.rows.load()
        assert [entry.number for entry in run.chosen(entries, "8, 1-2")] == [1, 2, 8]
        assert all(entry.dangerous for entry in run.chosen(entries, "dangerous"))
        assert run.chosen(entries, "") == list(entries.values())
        with pytest.raises(SystemExit, match="no row 99"):
            run.chosen(entries, "99")

    def test_a_result_that_is_not_there_is_said_so(self):
        from campaign import rows

        (first, *_) = rows.load().values()
        assert f"| {first.number} | {first.fault} | {' '.join(first.expected.reactions)} | not run |" in page.page(
            {first.number: dataclasses.replace(first)}, {}
        )


def test_what_a_message_says_of_the_run_alone_is_left_out():
    said = f"log: \x1b[31m[ERROR] [1795450883.424379]: {page.ROOT}/devel/lib/a.py and /tmp/pytest-1/b.log ended"
    assert (
        json.loads(page.as_json({"1": {"named": said}}))["1"]["named"] == "log: [ERROR] devel/lib/a.py and b.log ended"
    )

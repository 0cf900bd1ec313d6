"""The campaign's judge can fail: traces of right reactions pass, those of wrong ones do not. And its page and rows."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from campaign import page
from campaign.judge import FULL_SPEED, Evidence, Expected, Limits, judge
from common import clock
from common.poses import translation
from golden.chain import parsed
from kuka_control.loop.assembly import motion_limits
from kuka_control.loop.goal_stream import GoalStream, GoalStreamSettings
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.rig import Rig
from kuka_control.model.target import MotionScaling
from rig_simulation.devices.sunrise.robot import Drives, lts_law

FAULT = 100.0


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


def sways(amplitude):
    """Returns the steps of an arm whose joint 1 sways for ever by so much either way [rad], in 2 s."""
    t = np.arange(-0.5, 8.0, 1e-3)
    q, v = np.zeros((2, len(t), 7))
    q[:, 0], v[:, 0] = amplitude * np.sin(np.pi * t), amplitude * np.pi * np.cos(np.pi * t)
    return np.column_stack([FAULT + t, q, v, np.abs(v[:, 0])])


def statuses(*changes):
    """Returns a status every 0.1 s; `changes`: (time after the fault [s], mode)."""
    found = []
    for t in np.arange(-0.5, 8.0, 0.1):
        mode = [m for when, m in ((-1.0, "servo"), *changes) if when <= t][-1]
        found.append((FAULT + t, mode, mode != "stopped"))
    return found


def seen(**fields):
    return Evidence(**{"steps": stops(), "fault": FAULT, "end": FAULT + 8.0, "heard": FAULT + 8.0, **fields})


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
            (arm((0.03, -10.0), (2.89, 0.0), (0.03, 10.0)), "did not come to rest"),
            (arm(speed=0.0), "did not move"),
        ],
        ids=["late", "never", "too hard", "speeds up", "at full speed", "turns back", "stood anyway"],
    )
    def test_one_that_does_otherwise_fails(self, steps, fault):
        found = verdict(self.expected, steps=steps, mended=FAULT + 3.0)
        assert found.result == "failed" and any(fault in text for text in found.faults)

    def test_a_fault_that_is_too_short_shows_no_hold(self):
        found = verdict(self.expected, mended=FAULT)
        assert found.faults == ["H: the fault ended before a hold could be seen"]

    def test_times_and_the_stream_s_limit_are_judged_in_virtual_time_only(self):
        late, hurried = stops(delay=0.8), stops(rate=14.0, speed=0.6)
        assert verdict(self.expected, steps=late, exact=False).result == "passed"
        assert verdict(self.expected, steps=hurried).result == "failed"
        assert verdict(self.expected, steps=hurried, exact=False).result == "passed"
        assert verdict(self.expected, steps=stops(rate=40.0, speed=0.6), exact=False).result == "failed"


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
            ([(-0.9, "home")], "did not follow before"),
        ],
    )
    def test_otherwise_fails(self, changes, fault):
        found = verdict(self.expected, statuses=statuses(*changes))
        assert found.result == "failed" and any(fault in text for text in found.faults)

    @pytest.mark.parametrize(
        ("steps", "fault"),
        [(lambda: sways(0.1), "turned back by 0.2"), (lambda: arm((8.0, 0.0)), "still moved at the end")],
        ids=["follows a hand that sways", "goes on and on"],
    )
    def test_an_arm_that_does_not_do_what_its_controller_says_fails(self, steps, fault):
        found = verdict(self.expected, steps=steps(), statuses=statuses((0.4, "returning"), (3.0, "home")))
        assert found.result == "failed" and any(fault in text for text in found.faults), found.faults

    def test_the_way_home_and_the_trial_of_servo_mode_pass(self):
        home = arm((0.0375, -8.0), (1.5, 0.0), (0.3, -1.0), (1.5, 0.0), (0.3, 1.0))  # first on, then all the way back
        for steps in (home, sways(0.014)):
            found = verdict(self.expected, steps=steps, statuses=statuses((0.4, "returning"), (4.0, "home")))
            assert found.result == "passed", found.faults

    def test_an_arm_that_left_just_before_the_operator_acted_was_not_watched(self):
        found = verdict(self.expected, statuses=statuses((0.4, "home")), operator=FAULT + 1.8)
        assert found.faults == ["D: the arm was watched for 0.3 s only after it had left, too short to judge"]

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

    def test_a_drift_within_the_time_that_the_reaction_may_take_fails(self):
        drifts = arm((0.0375, -8.0), (1.0, 0.0), (0.1, 3.0), (1.0, 0.0), (0.1, -3.0))
        found = verdict(Expected("L", within=9.0), statuses=statuses((0.4, "stopped")), steps=drifts)
        assert found.result == "failed" and found.faults[0].startswith("L: the arm moved by"), found.faults

    def test_an_arm_that_was_latched_just_before_the_operator_acted_was_not_watched(self):
        found = verdict(self.expected, statuses=statuses((0.4, "stopped")), operator=FAULT + 1.2)
        assert found.faults == ["L: the arm was watched for 0.2 s only after it had been latched, too short to judge"]


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


NOTHING = {"steps": arm((6.0, 0.0)), "statuses": statuses(), "mended": FAULT + 3.0}
"""What is seen where nothing reacts: the arm moves on, the mode stays, nobody says anything."""


@pytest.mark.parametrize("reaction", "HDSLR")
def test_a_reaction_that_does_not_come_fails_whatever_else_comes(reaction):
    others = {
        "steps": stops(),
        "statuses": statuses((0.4, "stopped")),
        "events": [(FAULT + 0.3, "received stopDirectServoJoints")],
        "said": [(FAULT + 0.2, "rosout", "refused: too far")],
    }
    makes = {"H": ("steps",), "D": ("statuses",), "L": ("statuses", "steps"), "S": ("events",), "R": ("said",)}
    expected = Expected(reaction, within=1.0, named_by="too far" if reaction == "R" else "")
    assert verdict(expected, **others).result == "passed"
    for kind in makes[reaction]:
        left = {**others, **{kind: NOTHING.get(kind, [])}}
        found = verdict(expected, mended=FAULT + 3.0, **left)
        assert found.result == "failed" and any(fault.startswith(f"{reaction}: ") for fault in found.faults)


@pytest.mark.parametrize("reaction", "HDSL")
def test_a_fault_that_nobody_names_fails(reaction):
    seen_too = {"statuses": statuses((0.4, "stopped")), "events": [(FAULT + 0.3, "received stopDirectServoJoints")]}
    expected = Expected(reaction, within=1.0, named_by="tracker .* lost")
    named = verdict(expected, said=[(FAULT + 1.0, "rosout", "The tracker is lost.")], **seen_too)
    assert named.result == "passed" and named.named == "rosout: The tracker is lost."
    for said in ([], [(FAULT - 1.0, "rosout", "The tracker is lost.")], [(FAULT + 1.0, "rosout", "The arm is lost.")]):
        assert verdict(expected, said=said, **seen_too).faults == ["no message named it (/tracker .* lost/)"]


def test_an_arm_that_holds_and_follows_again_without_the_operator_fails():
    expected = Expected("H", within=1.0, operator=True)
    away = statuses((0.4, "home"), (4.0, "servo"))
    assert verdict(expected, statuses=away).faults == ["it followed again without the operator"]
    assert verdict(expected, statuses=statuses()).faults == ["it followed again without the operator"]
    assert verdict(expected, statuses=away, operator=FAULT + 3.0).result == "passed"


class TestSustainedAcceleration:
    """A late goal makes the drives hurry at their own limit; goals beyond the limits of the stream do so for longer."""

    expected = Expected("", 1.0, limits=Limits.of_the_drives())

    def test_a_short_hurry_passes_and_a_long_one_fails(self):
        short = verdict(self.expected, steps=arm((0.03, 17.0), (0.06, 0.0), (0.036, -17.0), speed=0.1))
        assert short.result == "passed" and short.joint_acceleration == pytest.approx(17.0, rel=0.01)
        long = verdict(self.expected, steps=arm((0.085, -16.0), (0.1, 0.0), speed=0.68))
        assert long.faults == ["acceleration over 80 ms [rad/s^2] 16.000 is above 14.5"]

    @pytest.mark.parametrize("late", [0.0, 0.06], ids=["goals in time", "late goals"])
    @pytest.mark.parametrize(("limit", "result"), [(12.0, "passed"), (24.0, "failed")])
    def test_behind_a_hand_that_dashes_the_limiter_makes_the_difference(self, limit, result, late):
        found = verdict(self.expected, steps=dash(limit, late))
        assert found.result == result and found.joint_speed > 0.5, (found.faults, found.sustained_acceleration)


def dash(limit, late):
    """Returns the steps of the simulated arm behind a hand that moves to and fro by 0.16 m, each way in 0.35 s.

    `limit`: of the stream's accelerations [rad/s^2]; a few goals come `late` by so much [s].
    """
    config = parsed("kuka", {})
    rig = Rig.of(config, None, None)
    # Within its range, the parameter cannot be so high.
    limits = motion_limits(dataclasses.replace(config, joint_acceleration=limit, joint_jerk=1000.0 * limit / 12.0), rig)
    settings = GoalStreamSettings(
        config.joint_speed * rig.model.max_speed, config.tcp_speed, True, rig.model.lower, rig.model.upper
    )
    q, v, before, goal = rig.home.q.copy(), np.zeros(7), None, rig.home.q
    goals, drives = GoalStream(settings, limits, True, q, 0.0), Drives(FULL_SPEED, FULL_SPEED / 0.1, 0.04)
    rng, next_goal, steps = np.random.default_rng(0), 0.0, []
    for i in range(2500):
        t = 1e-3 * i
        if i % 20 == 0:
            s = abs((t / 0.35 + 1.0) % 2.0 - 1.0)
            left = 0.16 * (s**3 * (10.0 - 15.0 * s + 6.0 * s * s) - 0.5)
            T = translation(left / np.sqrt(2.0), left / np.sqrt(2.0), 0.0) @ rig.home.T_base_tool
            before = rig.chain.resolve(T, MotionScaling(), goals.q_target, before, 0.02)
            frame = DesiredFrame(T, t)
            assert goals.take(frame, before.q, q, t, goals.hear(frame, t)) is None
        if t >= next_goal:
            next_goal = t + 0.01 + (late if rng.random() < 0.05 else 0.0)
            goal = goals.goal(q, t).q
        v = drives.towards(lts_law(goal - q), v, 1e-3)
        q = q + 1e-3 * v
        steps.append([FAULT + t, *q, *v, 0.0])
    return np.array(steps)


def test_an_arm_that_nobody_watched_to_the_end_fails():
    found = verdict(Expected("H", within=0.5), heard=FAULT + 5.0)
    assert found.faults == ["the arm was not seen for the last 3.0 s"]


def test_servo_mode_is_left_by_its_command():
    expected = Expected("S", within=1.0)
    assert verdict(expected, events=[(FAULT + 0.3, "received stopDirectServoJoints")]).result == "passed"
    assert verdict(expected, events=[(FAULT - 0.3, "received stopDirectServoJoints")]).result == "failed"


def test_deaths_and_the_conditions_of_a_row_fail_it():
    expected = Expected("H", within=0.5)
    assert verdict(expected, died=["/leap_driver"]).faults == ["died: /leap_driver"]
    assert verdict(expected, failed=["not so: the hand opens"]).faults == ["not so: the hand opens"]


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
        times = json.loads(run.TIMES.read_text())
        assert run.PAGE.read_text() == page.page(run.rows.load(), results, times)
        assert run.RESULTS.read_text() == page.as_json(results)
        assert run.TIMES.read_text() == page.times_as_json(times)

    def test_no_row_passes_where_nothing_happens_but_those_that_look_at_conditions_only(self):
        from campaign import rows

        passed = {n for n, row in rows.load().items() if judge(row.expected, seen(**NOTHING)).result == "passed"}
        assert passed == {n for n, row in rows.load().items() if not (row.expected.reactions or row.expected.named_by)}
        assert all(row.expected.named_by for row in rows.load().values() if "R" in row.expected.reactions)

    @pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.8, 0.6, 0.0)])
    def test_how_far_an_orientation_is_from_a_turn(self, axis):
        from campaign.hostile import about
        from campaign.rows.frames_and_time import off_the_turn

        axis, R_start = np.array(axis), about(np.array([0.6, -0.8, 0.0]), 2.0)
        for angle, nearest in ((0.0, 0.0), (1.0, 1.0), (1.9, 1.5), (-0.2, 0.0), (-3.0, 0.0)):
            off, turn = off_the_turn(about(axis, angle) @ R_start, R_start, axis, 0.0, 1.5)
            assert (off, turn) == (pytest.approx(abs(angle - nearest), abs=1e-9), pytest.approx(nearest, abs=1e-9))
        tilted = about(np.array([0.6, -0.8, 0.0]), 0.3) @ about(axis, 0.7) @ R_start
        assert off_the_turn(tilted, R_start, axis, 0.0, 1.5)[0] == pytest.approx(0.3, abs=1e-9)

    def test_a_part_of_a_row_fails_it(self):
        from campaign.trial import Trial

        arm = SimpleNamespace(steps=stops(delay=0.8).tolist(), events=[], heard=clock.monotonic())
        trial = Trial(SimpleNamespace(arm=arm, said=[], statuses=statuses(), entered=[], exact=True))
        trial.begins(FAULT)
        trial.part("held", Expected("H", within=0.5))
        trial.begins(FAULT)
        found = judge(Expected("", 1.0), trial.evidence([]))
        assert (found.result, found.faults) == ("failed", ["held: H: only after 0.84 s, expected within 0.5 s"])

    def test_a_condition_is_a_sentence_of_what_is_to_be_and_said_only_if_it_is_not_so(self):
        from campaign.trial import Trial

        trial = Trial(None)
        trial.check("the hand opens", True, "0.3 rad")
        trial.check("the arm stands", np.bool_(False), np.zeros(2))
        assert trial._failed == ["not so: the arm stands ([0. 0.])"]

    def test_a_row_that_provokes_nothing_fails(self):
        from campaign import trial

        arm = SimpleNamespace(steps=[], events=[], heard=clock.monotonic())
        rig = SimpleNamespace(arm=arm, said=[], statuses=[], entered=[], pids=dict, exact=True)
        entry = trial.Row(99, "nothing", Expected("", 1.0), lambda row: row.check("fine", True))
        assert trial.run(rig, entry).faults == ["the row provoked nothing"]
        begins = dataclasses.replace(entry, provoke=lambda row: row.begins())
        assert trial.run(rig, begins).result == "passed"

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
            {first.number: dataclasses.replace(first)}, {}, {}
        )


def test_what_a_message_says_of_the_run_alone_is_left_out():
    said = f"log: \x1b[31m[ERROR] [1795450883.424379]: {page.ROOT}/devel/lib/a.py and /tmp/pytest-1/b.log ended"
    assert (
        json.loads(page.as_json({"1": {"named": said}}))["1"]["named"] == "log: [ERROR] devel/lib/a.py and b.log ended"
    )


@pytest.mark.ros
def test_the_experiment_with_policies_counts_each_limit_that_an_arm_breaks():
    from campaign.arm_trace import Sample
    from campaign.policy import broken_by
    from kuka_control.model.workspace import Workspace

    workspace = Workspace(np.array([1.0, 0.0, 0.0]), np.radians(90.0), 0.2, 0.6, 0.5, 0.7, 0.34)
    T = np.eye(4)
    T[:3, 3] = workspace.centre
    still = Sample(0.0, np.zeros(7), np.zeros(7), T, 0.0, "", None, 0, 0, True)
    assert broken_by(still, workspace, True) == []
    low, fast = T.copy(), np.zeros(7)
    low[2, 3], fast[6] = 0.15, np.radians(175.0)
    assert broken_by(dataclasses.replace(still, T_base_tool=low), workspace, True) == ["workspace"]
    assert broken_by(dataclasses.replace(still, T_base_tool=low), workspace, False) == []
    assert broken_by(dataclasses.replace(still, v=-fast), workspace, True) == ["joint speed"]
    assert broken_by(dataclasses.replace(still, tool_speed=0.72), workspace, True) == ["tool speed"]
    assert broken_by(dataclasses.replace(still, safety_stop="contact"), workspace, True) == ["safety stop"]


@pytest.mark.ros
def test_the_experiment_with_policies_counts_stops_and_what_the_guard_sees(virtual_graph):
    import rospy

    from campaign.policy import Progress
    from common import clock
    from rig_msgs.msg import GuardState, KukaStatus

    progress = Progress()
    statuses = rospy.Publisher("kuka/status", KukaStatus, queue_size=10)
    guards = rospy.Publisher("kuka/guard", GuardState, queue_size=10)
    for mode in ("servo", KukaStatus.STOPPED, KukaStatus.STOPPED, "servo", KukaStatus.STOPPED):
        statuses.publish(KukaStatus(mode=mode))
        clock.sleep(0.1)
    for on, distance in ((True, 0.05), (True, 0.017), (False, 0.0), (True, 0.019)):
        guards.publish(GuardState(on=on, distance=distance, margin=0.02))
        clock.sleep(0.1)
    progress._values = {"seconds": "9.5,10.0", "good": "2", "step": "done"}
    broken = {"stopped": 2, "guard": 1}
    assert progress.result == {"good": 2, "seconds": [9.5, 10.0], "broken": broken, "least_distance_m": 0.017}

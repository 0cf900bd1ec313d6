"""The arm over the toolbox's client: which readings come when."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from kst import Feedback, MotionInterrupted, ReplyTimeout, UnexpectedReply
from kuka_control.loop.arm import UNGUARDED, KstArm


def wrench_of(q, torques):
    return torques[:3], torques[:3] - q[:3]


class FakeClient:
    """Writes down what it is asked for; every answer is another array."""

    abilities = frozenset()

    def __init__(self):
        self.asked = Counter()
        self.silent = False
        self.fails = {}
        self.arrived = self.slow = False
        self.pending = []

    def __getattr__(self, name):
        def ask(*arguments):
            return self._answer(arguments[1] if name == "servo" else name)

        return ask

    def stream(self, q, feedback, wait):
        self.pending.append(feedback)
        return feedback

    def stream_joints(self):
        self.pending.append("joints")

    @property
    def open_goals(self):
        return len(self.pending)

    def answers(self, wait=0.0):
        found = []
        while self.pending and not (self.slow and wait > 0.0):
            asked = self.pending.pop(0)
            try:
                value = self._answer(asked)
            except UnexpectedReply as error:
                value = error
            found.append((Feedback.JOINTS if asked == "joints" else asked, value))
        return found

    def silence(self, wait):
        return 0.0

    def _answer(self, asked):
        self.asked[asked] += 1
        if self.silent and asked != "joints":
            raise ReplyTimeout("silent")
        if self.fails.get(asked):
            raise self.fails[asked].pop(0)
        return self.arrived if asked == "ptp_arrived" else np.full(7, float(self.asked[asked]))


def in_servo(client):
    arm = KstArm(client, wrench_of)
    arm.start_servo()
    client.asked.clear()
    return arm


def test_in_servo_mode_every_goal_brings_joints_and_each_tenth_every_other_kind():
    client = FakeClient()
    arm = in_servo(client)
    joints = arm.state.joints
    for _ in range(100):
        arm.servo(np.zeros(7))
        assert arm.state.joints is not joints
        joints = arm.state.joints
    assert client.asked[Feedback.JOINTS] == 60 and client.asked["joints"] == 40
    for kind in (Feedback.EXTERNAL_TORQUES, Feedback.MEASURED_TORQUES, Feedback.POSE, Feedback.FORCE):
        assert client.asked[kind] == 10
    assert arm.state.moment is not None and arm.take_remarks() == []
    assert arm.estimated_in_servo == ("moment",)


def test_on_a_slow_link_no_goal_waits_for_a_second_question():
    client = FakeClient()
    arm = in_servo(client)
    client.slow = True
    for _ in range(100):
        arm.servo(np.zeros(7))
        assert arm.silence() == 0.0
    assert client.asked[Feedback.JOINTS] == 60 and client.asked["joints"] == 0


def test_what_an_old_server_does_not_tell_is_said_once_and_calculated():
    client = FakeClient()
    client.fails = {
        Feedback.POSE: [UnexpectedReply("the force instead")] * 2,
        Feedback.FORCE: [ReplyTimeout("silent")] * 2,
    }
    arm = in_servo(client)
    pose, force = arm.take_remarks()
    assert "does not tell the pose" in pose and "does not tell the force" in force
    assert arm.estimated_in_servo == ("moment", "pose", "force")
    for _ in range(20):
        arm.servo(np.zeros(7))
    assert set(client.asked) == {Feedback.JOINTS, "joints", Feedback.EXTERNAL_TORQUES, Feedback.MEASURED_TORQUES}
    assert arm.state.T_base_tool is None
    np.testing.assert_array_equal(arm.state.force, arm.state.torques_external[:3])
    arm.stop_servo()
    arm.start_servo()
    assert arm.take_remarks() == []


def test_a_server_that_freezes_at_the_start_of_servo_mode_lacks_nothing():
    client = FakeClient()
    client.fails = {Feedback.POSE: [ReplyTimeout("silent")] * 2}
    arm = KstArm(client, wrench_of)
    client._answer, answer = lambda asked: _silent_after_pose(client, answer, asked), client._answer
    with pytest.raises(ReplyTimeout):
        arm.start_servo()
    assert arm.estimated_in_servo == ("moment",)


def _silent_after_pose(client, answer, asked):
    if asked == "joints" and client.asked[Feedback.POSE] == 2:
        raise ReplyTimeout("silent")
    return answer(asked)


def test_one_lost_answer_drops_no_kind_of_reading():
    client = FakeClient()
    client.fails = {Feedback.POSE: [UnexpectedReply("NaN")], Feedback.FORCE: [ReplyTimeout("silent")]}
    arm = in_servo(client)
    for _ in range(10):
        arm.servo(np.zeros(7))
    assert client.asked[Feedback.POSE] == client.asked[Feedback.FORCE] == 1
    assert arm.take_remarks() == []


def test_a_stop_whose_answer_is_lost_is_sent_again():
    client = FakeClient()
    arm = in_servo(client)
    client.fails = {"stop_joint_servo": [ReplyTimeout("silent")]}
    arm.stop_servo()
    assert client.asked["stop_joint_servo"] == 2


def test_at_rest_joints_come_each_time_and_the_rest_in_turn():
    client = FakeClient()
    arm = KstArm(client, wrench_of)
    for _ in range(10):
        arm.read()
    assert client.asked["joints"] == 11
    for kind in ("external_torques", "measured_torques", "pose", "force", "moment"):
        assert client.asked[kind] == 2


def test_during_a_motion_only_joints_are_asked_for():
    client = FakeClient()
    arm = KstArm(client, wrench_of)
    arm.start_ptp(np.zeros(7), 0.1)
    client.asked.clear()
    for _ in range(5):
        arm.read()
        assert not arm.ptp_arrived()
    assert set(client.asked) == {"joints", "ptp_arrived"}
    client.arrived = True
    assert arm.ptp_arrived()
    arm.read()
    assert "external_torques" in client.asked or "measured_torques" in client.asked


def test_a_silent_main_thread_is_left_alone_until_the_next_motion():
    client = FakeClient()
    arm = KstArm(client, wrench_of)
    client.silent = True
    with pytest.raises(ReplyTimeout):
        arm.read()
    client.asked.clear()
    arm.read()
    assert set(client.asked) == {"joints"}


def test_each_goal_is_reported_when_it_is_sent():
    sent, q = [], np.full(7, 0.5)
    arm = KstArm(FakeClient(), wrench_of, lambda goal, velocity: sent.append((goal.tolist(), velocity)))
    arm.start_ptp(q, 0.25)
    arm.start_servo()
    arm.servo(2.0 * q)
    assert sent == [(q.tolist(), 0.25), ((2.0 * q).tolist(), 0.0)]


def test_readings_cannot_be_written_to():
    arm = KstArm(FakeClient(), wrench_of)
    with pytest.raises(ValueError):
        arm.state.joints[0] = 1.0


RANGES = np.tile((-10.0, 10.0), (7, 1))


@pytest.mark.parametrize("knows", [True, False])
def test_a_motion_is_guarded_if_the_server_knows_such_and_it_is_said_once_if_not(knows):
    client, started = FakeClient(), []
    client.knows_guarded_ptp = lambda: knows
    client.start_ptp_joints = lambda *arguments: started.append(arguments[2])
    arm = KstArm(client, wrench_of, guarded=True)
    assert arm.take_remarks() == [UNGUARDED] * (not knows) and arm.take_remarks() == []
    arm.start_ptp(np.ones(7), 0.1, RANGES)
    assert started == [RANGES if knows else None]


def test_after_a_contact_the_torques_where_the_arm_stands_are_known_and_all_is_read_again():
    client = FakeClient()
    client.knows_guarded_ptp = lambda: True
    arm = KstArm(client, wrench_of, guarded=True)
    arm.start_ptp(np.ones(7), 0.1, RANGES)
    client.fails["ptp_arrived"] = [MotionInterrupted("a torque", torques=np.arange(7.0))]
    with pytest.raises(MotionInterrupted):
        arm.ptp_arrived()
    np.testing.assert_array_equal(arm.state.torques_external, np.arange(7.0))
    for _ in range(5):
        arm.read()
    assert client.asked["moment"] == 1

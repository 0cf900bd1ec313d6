"""The arm over the toolbox's client: which readings come when."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from kst.errors import ReplyTimeout
from kuka_control.arm import KstArm


def moment_of(q, torques):
    return torques[:3] - q[:3]


class FakeClient:
    """Writes down what it is asked for; every answer is another array."""

    def __init__(self):
        self.asked = Counter()
        self.silent = False
        self.arrived = False
        self.round_trip = 0.001

    def __getattr__(self, name):
        def ask(*_):
            self.asked[name] += 1
            if self.silent and name not in ("joints",):
                raise ReplyTimeout("silent")
            return self.arrived if name == "ptp_arrived" else np.full(7, float(self.asked[name]))

        return ask


def test_in_servo_mode_most_goals_bring_joints_and_each_tenth_every_other_kind():
    client = FakeClient()
    arm = KstArm(client, moment_of)
    arm.start_servo()
    for _ in range(100):
        arm.servo(np.zeros(7))
    assert client.asked["servo_joints"] == 60
    for kind in ("servo_external_torques", "servo_measured_torques", "servo_pose", "servo_force"):
        assert client.asked[kind] == 10
    assert arm.state.moment is not None


def test_at_rest_joints_come_each_time_and_the_rest_in_turn():
    client = FakeClient()
    arm = KstArm(client, moment_of)
    for _ in range(10):
        arm.read()
    assert client.asked["joints"] == 11
    for kind in ("external_torques", "measured_torques", "pose", "force", "moment"):
        assert client.asked[kind] == 2


def test_during_a_motion_only_joints_are_asked_for():
    client = FakeClient()
    arm = KstArm(client, moment_of)
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
    arm = KstArm(client, moment_of)
    client.silent = True
    with pytest.raises(ReplyTimeout):
        arm.read()
    client.asked.clear()
    arm.read()
    assert set(client.asked) == {"joints"}


def test_readings_cannot_be_written_to():
    arm = KstArm(FakeClient(), moment_of)
    with pytest.raises(ValueError):
        arm.state.joints[0] = 1.0

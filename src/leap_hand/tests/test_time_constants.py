"""The times that the robot hand depends on, each in seconds, as shipped: a doubled one fails a test here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_leap_hand import CONFIG, hand_with

from common import clock
from common.errors import DeviceError
from leap_hand.force_limit import FingerFeedback, ForceLimit
from leap_hand.teleop import GripperState, HandTeleop
from leap_motion.frames import TrackingFrame

DT = 0.01
OWNER, OTHER = hand_with(), replace(hand_with(), id=8, palm=np.array([0.3, 0.0, 0.0]))


class Play:
    """A hand at 100 Hz; it is followed at first, the last time at the time 0."""

    def __init__(self, hand_only):
        self.teleop, self.number, self.hand_only = HandTeleop(CONFIG, hand_only), 0, hand_only
        self.teleop.switch(True)
        for i in range(-20, 1):
            result = self.step(i * DT, OWNER)
        assert result.state is GripperState.FOLLOWING

    def step(self, now, *hands, reported=True):
        self.number += 1
        if not self.hand_only and reported:
            self.teleop.steered_by((7, False), now, False)
        return self.teleop.step(TrackingFrame(self.number, 0.0, hands), now)


def first(condition, longest=10.0):
    """Returns the first time at which the condition holds [s]; it is asked each DT."""
    return next(i * DT for i in range(1, round(longest / DT)) if condition(i * DT))


def near(seconds):
    return pytest.approx(seconds, abs=1.5 * DT)


def test_the_grip_is_kept_for_200_ms_after_the_hand_is_lost():
    play = Play(hand_only=False)
    assert first(lambda now: play.step(now).state is GripperState.OPEN) == near(0.2)


def test_the_owner_is_given_up_200_ms_after_it_was_seen():
    play = Play(hand_only=True)
    assert first(lambda now: "was in view already" in play.step(now, OTHER).reason) == near(0.2)


def test_without_a_report_nobody_steers_after_a_second_and_a_half():
    play = Play(hand_only=False)

    def nobody(now):
        return "does not report which hand" in play.step(now, OWNER, reported=False).reason

    assert first(nobody) == near(1.5)


def test_frames_are_missing_after_half_a_second():
    play = Play(hand_only=False)
    assert first(lambda now: play.teleop.silence(now) is not None) == near(0.5)


def test_no_finger_closes_after_half_a_second_without_a_state_of_the_robot_hand():
    limit = ForceLimit(CONFIG)
    limit.update(FingerFeedback((0.0,) * 3, ((0.0,) * 9,) * 3, (0.0,) * 3), 0.0)
    assert first(lambda now: limit.clip([0.0] * 4, now).silence) == near(0.5)


@pytest.mark.ros
class TestNode:
    """In virtual time."""

    def test_commands_follow_two_seconds_after_a_calibration_that_is_waited_for_ten(self, virtual_graph):
        import rospy
        from std_srvs.srv import Empty, EmptyResponse

        from common.robot_hand import HAND
        from leap_hand.ros.teleop_node import calibrate

        services = [rospy.Service(name, Empty, lambda _: EmptyResponse()) for name in HAND.calibrations]
        begin = clock.monotonic()
        calibrate(1.0)
        assert clock.monotonic() - begin == pytest.approx(2.05, abs=0.06)
        services[0].shutdown()
        rospy.Service(HAND.calibrations[0], Empty, lambda _: clock.sleep(60.0))
        begin = clock.monotonic()
        with pytest.raises(DeviceError):
            calibrate(1.0)
        assert clock.monotonic() - begin == pytest.approx(10.0, abs=0.1)

    def test_it_begins_two_seconds_later_without_a_state_of_the_robot_hand_and_looks_ten_times_a_second(
        self, virtual_graph, monkeypatch
    ):
        from leap_hand.ros.teleop_node import HandTeleopNode

        times = []
        begin = clock.monotonic()

        def node():
            import rospy

            rospy.init_node("leap_hand_node")
            made = HandTeleopNode(HandTeleop(CONFIG, False), ForceLimit(CONFIG))
            monkeypatch.setattr(made._teleop, "silence", lambda now: times.append(now - begin))
            made.run(lambda *_: times.append(clock.monotonic() - begin))

        virtual_graph.start("leap_hand_node", node)
        clock.sleep(3.0)
        assert times[0] == pytest.approx(2.0, abs=0.01)
        np.testing.assert_allclose(np.diff(times[1:]), 0.1, atol=1e-3)

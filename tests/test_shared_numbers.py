"""Numbers that packages keep for themselves, since none may import the other, and that belong together."""

from __future__ import annotations

from kuka_control import numbers as of_the_controller
from leap_kuka import numbers as of_the_teleoperation
from leap_motion import numbers as of_a_tracker


def test_a_tracker_knows_when_a_hand_is_lost_and_how_fast_its_frames_must_come():
    assert of_a_tracker.KEPT_S == of_the_teleoperation.MAX_SILENCE_S
    assert of_a_tracker.ENOUGH_RATE_HZ == of_the_teleoperation.ENOUGH_RATE_HZ


def test_axes_that_change_end_an_engagement_at_any_frame_rate():
    longest = of_the_teleoperation.MAX_SILENCE_S + 1.0 / of_the_teleoperation.MIN_RATE_HZ
    assert longest < of_a_tracker.SETTLE_S


def test_the_arm_follows_wherever_a_hand_may_steer_again():
    assert of_the_teleoperation.MIN_RATE_HZ >= of_the_controller.HOLD_HZ
    assert of_the_teleoperation.ENOUGH_RATE_HZ > of_the_controller.RESUME_HZ

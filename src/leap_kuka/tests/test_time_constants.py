"""The times that a hand on the arm depends on, each in seconds: a doubled constant fails a test here."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from relative_rig import Rig

from common import clock
from common.config import parse
from common.hand_tracking import LONG_GAP_S
from common.poses import pose
from leap_kuka import numbers
from leap_kuka.operator_devices import OperatorInput, OperatorInputConfig
from leap_kuka.operator_switches import DeviceSwitches, SecondHandSwitch
from leap_kuka.start_gate import READY
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import StreamState
from leap_motion.frames import TrackingFrame

DT = 0.01
NO_DEVICE = {"device": "", "enable_key": "", "clutch_key": "", "joy_clutch_button": -1, "debounce": 0.05}


def first(condition, longest=10.0):
    """Returns the first time at which the condition holds [s]; it is asked each DT."""
    return next(i * DT for i in range(round(longest / DT)) if condition(i * DT))


def near(seconds):
    return pytest.approx(seconds, abs=1.5 * DT)


def test_a_device_is_silent_after_250_ms_and_has_left_after_two_seconds():
    switches = DeviceSwitches()
    switches.take(False, False, "pedal", 0.0, -DT, "a")
    switches.take(True, False, "pedal", 0.0, 0.0, "a")
    assert first(lambda now: not switches.enabled(now)) == near(0.25)
    assert first(switches.silent) == near(0.25)

    def left(now):
        switches.take(True, False, "gamepad", 0.0, now, "b")
        return now > 0.3 and not switches.silent(now)

    assert first(left) == near(2.0)
    assert switches.take(True, False, "pedal", 0.24, 3.0) is None and switches.take(True, False, "pedal", 0.26, 3.0)


def test_a_gamepad_is_lost_after_half_a_second():
    values = {**NO_DEVICE, "joy_enable_button": 4, "joy_clutch_button": 5}
    operator = OperatorInput(parse(OperatorInputConfig, values, ""))
    operator.gamepad.take([0] * 6, -0.2)
    operator.gamepad.take([0, 0, 0, 0, 1, 0], -0.1)
    operator.gamepad.take([0, 0, 0, 0, 1, 0], 0.0)
    assert operator.state(0.0)[0]
    assert first(lambda now: not operator.state(now)[0]) == near(0.5)


@pytest.mark.parametrize("clutch", [True, False])
def test_the_second_hand_moves_the_tool_after_100_ms_and_has_left_after_100_ms(sample, clutch):
    switch = SecondHandSwitch("second_hand_fist", clutch, 0.05)
    safe, moves = [sample(grab=float(clutch))], [sample(grab=float(not clutch))]
    switch.update(safe, -DT, True)

    def released(now):
        switch.update(moves, now, True)
        return switch.pressed is not clutch

    assert first(released) == near(0.1)
    if not clutch:
        for gap, counts in ((0.09, True), (0.11, False)):
            switch.update(safe, 1.0, True)
            for i in range(20):
                switch.update(moves, 1.0 + gap + i * DT, True)
            assert switch.pressed is counts


def test_a_controller_that_reports_no_longer_is_silent_after_a_second_and_a_half(leap, arm, sample):
    rig = Rig(leap, arm, sample, pose(p=(0.42, -0.42, 0.4)))
    number = iter(range(1000, 2000))

    def silent(now):
        rig.teleop.switches.device.take(True, False, "pedal", 0.0, rig.now + now)
        return READY in rig.teleop.step(TrackingFrame(next(number), 0.0, (sample(pitch=60.0),)), rig.now + now).unmet

    assert first(silent) == near(1.5)


def test_a_hand_starts_once_the_arm_has_left_the_hand_before(leap, arm, sample, player):
    play = player(ArmTeleop(leap(), arm()))
    assert play.come_in(sample())[-1].state is StreamState.RUNNING
    other = sample(id=13, position=(0.0, 0.35, 0.3))
    assert first(lambda _: play.step(other).state is not StreamState.RUNNING) == near(0.2)
    assert 0.2 + first(lambda _: READY not in play.step(other).unmet) == near(0.3)


def test_a_hand_that_cannot_start_leaves_its_turn_to_another_one_after_half_a_second(leap, arm, sample, player):
    play = player(ArmTeleop(leap(), arm()))
    rolled, other = sample(roll=60.0), sample(id=13, position=(0.08, 0.35, 0.0))
    play.steps(30, sample(roll=60.0, position=(0.0, 0.35, 0.3)))
    play.steps(10, rolled, sample(id=13, position=(0.08, 0.35, 0.3)))
    found = 0.4 + first(lambda _: play.step(rolled, other).state is StreamState.RUNNING)
    assert found == near(0.5 + 0.1 + 0.1), "until the mean of either hand is full takes 0.1 s"


def test_the_arm_is_asked_each_200_ms_whether_it_can_follow(leap, arm, sample, player):
    asked = []
    play = player(ArmTeleop(leap(), arm(), lambda T, starts: asked.append((play.now, starts))))
    play.come_in(sample())
    play.steps(100, sample())
    running = [now for now, starts in asked if not starts]
    assert len(running) >= 3, "it is asked while the stream runs"
    np.testing.assert_allclose(np.diff(running), 0.2, atol=1.5 * DT)


@pytest.mark.ros
def test_a_measured_tool_is_half_a_second_old_at_most(virtual_graph):
    import rospy
    from tf2_msgs.msg import TFMessage

    from common.frames import BASE, FLANGE_MEASURED
    from common.ros.conversions import stamped_transform
    from leap_kuka.ros.measured_tool import MeasuredTool
    from rig_msgs.msg import KukaStatus

    publisher, measured = rospy.Publisher("/tf", TFMessage, queue_size=10), MeasuredTool(np.eye(4))
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
    clock.sleep(0.1)

    def send(age, parent=BASE):
        stamp = rospy.Time.now() - rospy.Duration(age)
        publisher.publish(TFMessage([stamped_transform(np.eye(4), parent, FLANGE_MEASURED, stamp)]))
        clock.sleep(0.005)

    send(0.0)
    with pytest.raises(ValueError, match="the controller of the arm publishes no"):
        measured()  # anybody's
    status.publish(KukaStatus())
    clock.sleep(0.01)
    send(0.0, "world")
    with pytest.raises(ValueError, match="is not in"):
        measured()

    send(0.49)
    measured()
    send(0.51)
    with pytest.raises(ValueError, match="the stamp of"):
        measured()
    send(0.0)
    clock.sleep(0.48)
    measured()
    clock.sleep(0.03)
    with pytest.raises(ValueError, match="0.5 s old"):
        measured()


PAGE = (Path(__file__).parents[3] / "docs" / "handbook" / "engagement.md").read_text()
SAID = {
    "on average over this time. | {:.2f} s": numbers.STILL_WINDOW_S,
    "ended this long ago. | {:.1f} s": numbers.PAUSE_S,
    "answer within {:.1f} s": numbers.REACH_TIMEOUT_S,
    "after {:.1f} s the other has its turn": numbers.TURN_S + 10.0 / numbers.NOMINAL_RATE_HZ,  # leap/buffer_size
    "no frame for {:.1f} s": numbers.MAX_SILENCE_S,
    "after a gap above {:.1f} s": LONG_GAP_S,
    "asked every {:.1f} s": numbers.REACH_RUNNING_S,
    "younger than {:.1f} s": numbers.MAX_STATUS_AGE_S,
    "older than {:.1f} s starts nothing": numbers.MEASURED_AGE_S,
    "its stamps off by {:.2f} s": numbers.DEVICE_SILENCE_S,
    "clutch device silent for {:.2f} s": numbers.DEVICE_SILENCE_S,
    "as released; after {:.1f} s": numbers.GAP_S,
    "until seen open for {:.1f} s": numbers.DEBOUNCE_S,
    "must last ({:.2f} s)": parse(OperatorInputConfig, {}, "").debounce,
}
"""What the handbook says of times, and the time that it means."""


def test_the_handbook_says_the_times_of_the_code():
    said = [text.format(seconds) for text, seconds in SAID.items()]
    assert [text for text in said if text not in PAGE] == []
    assert len(re.findall(r"\d s\b", PAGE)) == len(SAID), "another time: say here which one it is"

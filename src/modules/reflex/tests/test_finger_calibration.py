"""The finger calibration ends, whatever the hand does, and never closes a finger further than its bound."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reflex.calibration import FingerCalibration
from reflex.codec import StatePacket
from reflex.conversions import ENCODER_RAD, SIGNS, joint_angle

PERIOD_S = 0.025
START = StatePacket(
    device_time=0,
    pressures=((140,) * 9,) * 3,
    encoders=(8000, 8000, 8000),
    errors=(0,) * 4,
    positions=(13500, 13500, 13500, 13500),
    speeds=(0,) * 4,
    loads=(0,) * 4,
    voltages=(120,) * 4,
    temperatures=(30,) * 4,
)


class Hand:
    """Servos that reach each target at once; a knuckle turns after its slack [ticks], or never (None)."""

    def __init__(self, slacks=(20, 30, 40), start=START) -> None:
        self.slacks = slacks
        self.start = self.packet = start
        self.targets = []
        self.now = 50.0
        self.shift = [0, 0, 0, 0]

    def calibrate(self, calibration, loads=(0.0,) * 4, change=lambda hand, count: None, most=2000):
        for count in range(most):
            change(self, count)
            step = calibration.step(self.packet, loads, self.now)
            if step.target is not None:
                self.targets.append(step.target)
                self.move(step.target)
            if step.failure or step.zeros is not None:
                return step
            self.now += PERIOD_S
        pytest.fail("the calibration does not end")

    def move(self, target):
        encoders = list(self.start.encoders)
        for i, slack in enumerate(self.slacks):
            closed = SIGNS[i] * (target[i] - self.start.positions[i] - self.shift[i])
            if slack is not None:
                encoders[i] = round(encoders[i] - max(0, closed - slack) * 8) % 16384
        self.packet = replace(self.packet, positions=tuple(target), encoders=tuple(encoders))


def test_finds_where_each_knuckle_turns(make_settings):
    hand = Hand()
    step = hand.calibrate(FingerCalibration(make_settings()))
    np.testing.assert_allclose(step.zeros.encoder_zero_reference, [8000 * ENCODER_RAD] * 3)
    for i, slack in enumerate(hand.slacks):
        turned = 0.05 / (8 * ENCODER_RAD)
        zero = SIGNS[i] * (hand.targets[-1][i] - 13500)
        assert slack + turned - 50 <= zero <= slack + turned + 12 - 50
        assert joint_angle(i, hand.targets[-1][i], step.zeros.motor_zero_reference[i]) == pytest.approx(0)
    assert all(target[3] == 13500 for target in hand.targets)


slacks = st.one_of(st.none(), st.integers(0, 400))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(slack=st.tuples(slacks, slacks, slacks), most=st.integers(20, 300), step_ticks=st.integers(4, 20))
def test_is_bounded(make_settings, slack, most, step_ticks):
    hand = Hand(slack)
    config = make_settings(calibration_max_closing=most, calibration_step=step_ticks)
    step = hand.calibrate(FingerCalibration(config))
    for target in hand.targets:
        closed = [SIGNS[i] * (target[i] - 13500) for i in range(3)]
        assert max(closed) <= most
    if step.failure:
        assert hand.targets[-1] == START.positions
    assert hand.now - 50.0 <= config.calibration_max_time + PERIOD_S
    reachable = all(s is not None and s + 17 + 2 * step_ticks < most for s in slack)
    assert not (reachable and step.failure), step.failure
    if any(s is None or s > most for s in slack):
        assert step.failure


def test_motors_that_do_not_move_end_by_time(make_settings):
    hand = Hand()
    hand.move = lambda target: None
    step = hand.calibrate(FingerCalibration(make_settings()))
    assert step.failure == "After 8 s the knuckles of f1, f2, f3 had not turned."


@pytest.mark.parametrize("motor", range(4))
def test_a_servo_without_position_ends_it_and_nothing_is_sent(make_settings, motor):
    """Reported in https://github.com/RightHandRobotics/reflex-ros-pkg/issues/36: servos that read 0 are driven too
    far. Tried: a servo at 0.
    """

    def unplug(hand, count):
        positions = list(hand.packet.positions)
        positions[motor] = 0
        if count == 3:
            hand.packet = replace(hand.packet, positions=tuple(positions))

    hand = Hand()
    step = hand.calibrate(FingerCalibration(make_settings()), change=unplug)
    assert "cannot be right" in step.failure
    assert step.target is None


def test_a_load_ends_it(make_settings):
    hand = Hand()
    step = hand.calibrate(FingerCalibration(make_settings()), loads=(0, 400.0, 0, 0))
    assert "f2 has a load of 400" in step.failure
    assert hand.targets[-1] == START.positions


def test_encoders_may_pass_their_end(make_settings):
    hand = Hand(start=replace(START, encoders=(5, 8000, 100)))
    assert hand.calibrate(FingerCalibration(make_settings())).zeros is not None


@pytest.mark.parametrize("turn", [1024, -1024, -1021])
def test_a_servo_that_counts_from_another_turn_gets_a_new_target_at_once(make_settings, turn):
    def jump(hand, count):
        if count == 5:
            hand.shift = [turn, 0, 0, 0]
            hand.packet = replace(hand.packet, positions=(hand.packet.positions[0] + turn, *hand.packet.positions[1:]))
            hand.before = len(hand.targets)
        if count == 6:
            assert len(hand.targets) == hand.before + 1
            assert abs(hand.targets[-1][0] - hand.packet.positions[0]) <= 6

    hand = Hand()
    step = hand.calibrate(FingerCalibration(make_settings()), change=jump)
    assert step.zeros is not None
    assert hand.targets[-1][0] > 13500 + turn - 50


def test_a_jump_that_is_no_turn_ends_it_where_the_servos_are(make_settings):
    def jump(hand, count):
        if count == 5:
            hand.packet = replace(hand.packet, positions=(9000, *hand.packet.positions[1:]))

    hand = Hand()
    step = hand.calibrate(FingerCalibration(make_settings()), change=jump)
    assert "jumped" in step.failure
    assert step.target[0] == 9000

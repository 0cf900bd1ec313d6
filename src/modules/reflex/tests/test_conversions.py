"""Counts and joint angles: the maker's vectors, and laws."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reflex.conversions import (
    ENCODER_RAD,
    RATIOS,
    TICK_RAD,
    closing_load,
    joint_angle,
    proximal_angle,
    raw_target,
    speed_units,
    ticks,
    zero_reference,
)

ZEROS = (59.0, 57.0, 58.0, 55.0)
motors = st.integers(0, 3)


@pytest.mark.parametrize(
    ("angles", "golden"),
    [
        ((0, 0, 0, 0), (13650, 13187, 13419, 13442)),
        ((0.5, 1.0, 1.5, 0.7), (13766, 12956, 13766, 13271)),
        ((3.6, 3.6, 3.6, 1.75), (14483, 12355, 14252, 13014)),
    ],
)
def test_golden_targets(angles, golden):
    assert tuple(raw_target(i, angles[i], ZEROS[i]) for i in range(4)) == golden


@pytest.mark.parametrize(
    ("speeds", "golden"),
    [((1, 2, 3, 30), (118, 1261, 356, 2047)), ((3, 3, 3, 2), (356, 1380, 356, 1275)), ((0, 0, 0, 0), (1, 1, 1, 1))],
)
def test_golden_speeds(speeds, golden):
    assert tuple(speed_units(i, speeds[i]) for i in range(4)) == golden


@given(motors, st.floats(0, 3.6), st.floats(54, 61))
def test_a_target_reads_back_as_its_angle_within_a_tick(motor, angle, zero):
    raw = raw_target(motor, angle, zero)
    assert abs(joint_angle(motor, raw, zero) - angle) <= TICK_RAD / RATIOS[motor]


@given(motors, st.integers(0, 65535))
def test_the_zero_of_a_position_makes_it_the_open_one(motor, raw):
    assert joint_angle(motor, raw, zero_reference(motor, raw)) == 0


@given(motors, st.integers(2000, 60000), st.floats(-3, 3))
def test_ticks_turn_the_joint(motor, raw, turn):
    zero = zero_reference(motor, raw)
    assert joint_angle(motor, raw + ticks(motor, turn), zero) == pytest.approx(turn, abs=1e-9)


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf, 40.0, -70.0])
def test_what_cannot_be_sent_is_refused(angle):
    with pytest.raises(ValueError, match="f1"):
        raw_target(0, angle, 59.0)


def test_a_speed_must_be_finite():
    with pytest.raises(ValueError, match="f2"):
        speed_units(1, math.nan)


@pytest.mark.parametrize(("motor", "register"), [(0, 1023 + 200), (1, 200), (2, 1023 + 200), (3, 200)])
def test_closing_load_is_positive(motor, register):
    assert closing_load(motor, register) == 200


@given(st.floats(0, 6.28), st.floats(-1.5, 4.6))
def test_proximal_is_continuous_across_the_end_of_the_encoder(zero, angle):
    raw = round((zero - angle) / ENCODER_RAD) % 16383
    assert proximal_angle(raw, zero) == pytest.approx(angle, abs=2 * ENCODER_RAD)

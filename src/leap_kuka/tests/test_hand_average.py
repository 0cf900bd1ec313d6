"""Hand frame, checks of a sample, mean and the gate against glitches."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.rotations import check_rotation
from leap_kuka.hand_average import HandAverage, hand_fault, hand_rotation
from leap_kuka.numbers import MAX_LEFT_OUT, NOMINAL_RATE_HZ

angles = st.floats(-180.0, 180.0)
small = st.floats(-60.0, 60.0)


@given(angles, st.floats(-89.0, 89.0), angles)
def test_the_hand_frame_is_a_rotation_with_x_along_the_hand_and_z_out_of_the_palm(sample, yaw, pitch, roll):
    hand = sample(yaw, pitch, roll)
    R = hand_rotation(hand.direction, hand.normal)
    check_rotation(R)
    np.testing.assert_allclose(R[:, 0], hand.direction, atol=1e-9)
    np.testing.assert_allclose(R[:, 2], hand.normal, atol=1e-9)
    np.testing.assert_allclose(R[:, 1], np.cross(hand.normal, hand.direction), atol=1e-9)


@pytest.mark.parametrize(
    "change, word",
    [
        ({"palm": (np.nan, 0.3, 0.0)}, "finite"),
        ({"direction": (0.0, 0.0, -np.inf)}, "finite"),
        ({"confidence": float("nan")}, "finite"),
        ({"palm": (0.0, 350.0, 0.0)}, "350.0 m"),
        ({"direction": (0.0, 0.0, 0.0)}, "direction of the hand has length 0"),
        ({"direction": (0.0, 0.0, -1.01)}, "length 1.01"),
        ({"normal": (0.0, -0.9, 0.0)}, "normal of the hand has length 0.9"),
        ({"normal": (0.0, 0.0, -1.0)}, "0.0 deg"),
        ({"normal": (0.0, -np.cos(0.02), -np.sin(0.02))}, "88.9 deg"),
        ({"confidence": 1.5}, "1.5"),
    ],
)
def test_numbers_that_are_no_hand_are_named(sample, change, word):
    assert word in hand_fault(dataclasses.replace(sample(), **change))


def test_six_printed_digits_are_good_enough(sample):
    hand = sample(31.0, 17.0, -8.0)
    rounded = dataclasses.replace(
        hand, direction=np.float32(np.round(hand.direction, 5)), normal=np.float32(np.round(hand.normal, 5))
    )
    assert hand_fault(rounded) is None


@given(st.integers(1, 20), st.integers(0, 40))
def test_there_is_a_mean_of_the_newest_exactly_when_the_window_is_full(sample, size, count):
    average = HandAverage(size)
    for i in range(count):
        assert average.add(sample(position=(0.001 * i, 0.35, 0.0)), i / NOMINAL_RATE_HZ) is None
    assert (average.mean() is not None) == (count >= size)
    if count >= size:
        assert average.mean().palm[0] == pytest.approx(0.001 * np.mean(range(count - size, count)))
    average.reset()
    assert average.mean() is None and average.count == 0


@given(small, small, small)
def test_the_mean_of_equal_samples_is_the_sample(sample, yaw, pitch, roll):
    average = HandAverage(3)
    hand = sample(yaw, pitch, roll, confidence=0.4)
    for i in range(3):
        average.add(hand, 0.01 * i)
    mean = average.mean()
    np.testing.assert_allclose(mean.palm, hand.palm, atol=1e-12)
    np.testing.assert_allclose(mean.T_leap_hand[:3, :3], hand_rotation(hand.direction, hand.normal), atol=1e-9)
    assert mean.confidence == pytest.approx(0.4)


@given(st.lists(st.tuples(small, small, small), min_size=4, max_size=4))
def test_the_mean_is_a_rotation_or_nothing(sample, attitudes):
    average = HandAverage(4)
    for i, (yaw, pitch, roll) in enumerate(attitudes):
        average.add(sample(yaw, pitch, roll), 0.01 * i)
    if average.mean() is not None:
        check_rotation(average.mean().T_leap_hand[:3, :3])


@pytest.mark.parametrize("noise", [0.0, 0.0005, 0.002])
def test_noise_does_not_make_a_still_hand_fast_and_no_hand_slow(sample, noise):
    rng = np.random.default_rng(3)

    def speeds(velocity):
        average = HandAverage(10)
        for i in range(1000):
            position = np.array([velocity * i / NOMINAL_RATE_HZ, 0.35, 0.0]) % 1.0
            average.add(sample(position=position + rng.normal(0.0, noise, 3)), i / NOMINAL_RATE_HZ)
            if average.mean() is not None:
                yield average.mean().speed

    assert max(speeds(0.0)) < 0.3
    assert np.mean([speed > 0.3 for speed in speeds(0.5)]) > 0.95


def test_a_hand_that_shakes_is_never_slow(sample):
    """5 Hz and 30 mm; a line through the whole window is level where the hand turns back."""
    average = HandAverage(10)
    for i in range(400):
        t = i / NOMINAL_RATE_HZ
        average.add(sample(position=(0.03 * np.sin(2.0 * np.pi * 5.0 * t), 0.35, 0.0)), t)
        assert average.mean() is None or average.mean().speed > 0.3


def test_a_hand_that_turns_over_within_the_window_has_no_mean(sample):
    average = HandAverage(2)
    average.add(sample(), 0.0)
    average.add(sample(roll=179.0), 0.01)
    assert average.mean() is None
    average.add(sample(roll=178.0), 0.02)
    assert average.mean() is not None


def test_one_glitch_is_left_out_and_the_mean_stands_still(sample):
    average = HandAverage(3)
    for i in range(3):
        average.add(sample(), 0.01 * i)
    before = average.mean().T_leap_hand
    assert "200 mm" in average.add(sample(position=(0.2, 0.35, 0.0)), 0.03)
    np.testing.assert_array_equal(average.mean().T_leap_hand, before)
    assert average.add(sample(position=(0.005, 0.35, 0.0)), 0.04) is None
    assert not average.lost and average.left_out == 0


def test_a_palm_that_jumped_and_stays_there_is_lost(sample):
    average = HandAverage(3)
    average.add(sample(), 0.0)
    for i in range(MAX_LEFT_OUT):
        assert not average.lost
        average.add(sample(position=(0.3, 0.35, 0.0)), 0.01 * (i + 1))
    assert average.lost


@pytest.mark.parametrize(
    "step, dt, taken",
    [
        (19, 0.009, True),
        (21, 0.009, False),
        (34, 0.0175, True),
        (19, 0.0, True),
        (190, 0.099, True),
        (190, 0.101, False),
        (29, 0.101, True),
        (56, 0.19, True),
        (58, 0.19, False),
    ],
)
def test_the_gate_is_one_of_speed_with_a_floor(sample, step, dt, taken):
    average = HandAverage(3)
    average.add(sample(), 1.0)
    assert (average.add(sample(position=(step / 1e3, 0.35, 0.0)), 1.0 + dt) is None) == taken

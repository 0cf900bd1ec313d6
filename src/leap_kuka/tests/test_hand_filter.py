"""Laws of the filters: known lag, no preferred axis or origin, bounded overshoot, less tremor than the mean."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.hand_tracking import LONG_GAP_S
from common.rotations import rotation_from_zyx
from leap_kuka import hand_filter
from leap_kuka.hand_average import FILTER_SIZE, HandAverage
from leap_kuka.hand_filter import FILTERS, ORIENTATION_MOTION, PALM_MOTION, Kalman, MotionKalman
from leap_kuka.numbers import NOMINAL_RATE_HZ

RATES = [30.0, 50.0, 74.0, 110.0, 200.0]
LEVEL = [0.0, 0.0, -1.0, 0.0, -1.0, 0.0]
REACH_S = 0.8  # of 20 cm: 0.47 m/s at the fastest
seeds = st.integers(0, 2**32 - 1)


def run(filter_, times, palms):
    """Filtered palms, shape (n, 3) [m], of palms, shape (n, 3) or the x coordinate alone, shape (n,)."""
    palms = np.column_stack([palms, np.zeros((len(palms), 2))]) if np.ndim(palms) == 1 else np.asarray(palms)
    return np.array([filter_.step([*p, *LEVEL], t)[:3] for p, t in zip(palms.tolist(), np.asarray(times).tolist())])


class Mean:
    """The mean of ten samples as a filter of palms."""

    def __init__(self):
        self.samples = []

    def step(self, sample, now):
        self.samples = [s for s in self.samples if s[0] > now - 10 / NOMINAL_RATE_HZ][-9:] + [(now, sample)]
        return np.mean([s for _, s in self.samples], axis=0).tolist()


def uneven(rate, seconds, seed=0, share=0.3):
    """Times of frames at a rate, each early or late by at most a share of the time between two frames."""
    grid = np.arange(0.0, seconds, 1.0 / rate)
    return grid + np.random.default_rng(seed).uniform(0.0, share / rate, len(grid))


def reaches(times):
    """A hand that reaches to and fro along x by 20 cm and rests between, and when it moves."""
    phase = times % 3.0
    s = np.clip((phase - 1.0) / REACH_S, 0.0, 1.0) - np.clip((phase - 2.0) / REACH_S, 0.0, 1.0)
    return 0.2 * (10 * s**3 - 15 * s**4 + 6 * s**5), (s > 0.0) & (s < 1.0)


def tremor(times, seed=0, size=0.001):
    """Tremor of 4 to 12 Hz with a standard deviation [m] in each coordinate, shape (n, 3)."""
    random = np.random.default_rng(seed)
    hertz, phase = random.uniform(4.0, 12.0, (80, 3)), random.uniform(0.0, 2.0 * np.pi, (80, 3))
    waves = np.sin(2.0 * np.pi * hertz * times[:, None, None] + phase).sum(axis=1)
    return size * waves / waves.std(axis=0)


def tremor_gain(make, rate, moving):
    times = uneven(rate, 30.0)
    x, moves = reaches(times)
    palms = np.column_stack([x, np.zeros((len(x), 2))])
    difference = run(make(), times, palms + tremor(times)) - run(make(), times, palms)
    return np.sqrt(np.mean(difference[(moves == moving) & (times > 1.0)] ** 2)) / 0.001


@pytest.mark.parametrize("speed", [0.05, 0.1, 0.3])
def test_the_one_euro_filter_lags_by_the_time_constant_of_its_cutoff(speed):
    times = np.arange(0.0, 3.0, 1.0 / 200.0)
    lag = (speed * times - run(FILTERS["one_euro"](), times, speed * times)[:, 0])[-1] / speed
    cutoff = hand_filter.MIN_CUTOFF_HZ + hand_filter.CUTOFF_PER_SPEED[0] * speed
    assert lag == pytest.approx(1.0 / (2.0 * np.pi * cutoff), abs=0.003)


@pytest.mark.parametrize("rate", RATES)
def test_the_kalman_filter_follows_a_reach_within_10_ms_and_the_mean_within_40(rate):
    times = uneven(rate, 12.0)
    x, _ = reaches(times)
    lags = np.arange(-0.02, 0.08, 0.001)

    def lag(filter_):
        v = np.diff(run(filter_, times, x)[:, 0])
        return lags[np.argmin([np.sum((np.diff(np.interp(times - s, times, x)) - v) ** 2) for s in lags])]

    assert -0.002 <= lag(Kalman()) <= 0.010
    assert lag(Mean()) > 0.020


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("rate", [74.0, 110.0, 200.0])
def test_the_kalman_filter_lets_no_more_tremor_through_than_the_mean_of_ten(rate, moving):
    assert tremor_gain(Kalman, rate, moving) <= tremor_gain(Mean, rate, moving)


@settings(max_examples=60)
@given(st.floats(0.02, 2.0), st.sampled_from(RATES), st.floats(0.3, 1.5), seeds)
def test_a_hand_that_stops_is_overshot_by_7_mm_at_most(speed, rate, stops_at, seed):
    """However sudden; and it is not moved any more a second later."""
    times = uneven(rate, 3.0, seed % 1000)
    x = speed * np.minimum(times, stops_at)
    palms = run(Kalman(), times, x)[:, 0]
    assert np.max(palms) <= x[-1] + PALM_MOTION.farthest + 1e-9
    assert np.max(np.abs(palms[times > stops_at + 1.0] - x[-1])) < 0.0005


@settings(max_examples=60)
@given(st.floats(-0.02, 0.02), st.sampled_from([74.0, 110.0, 200.0]), seeds)
def test_a_single_glitch_moves_the_kalman_filter_by_7_mm_at_most(size, rate, seed):
    times = uneven(rate, 2.0, seed % 1000)
    x = np.zeros(len(times))
    x[len(x) // 2] = size
    assert np.max(np.abs(run(Kalman(), times, x)[:, 0])) <= PALM_MOTION.farthest + 1e-12


@settings(max_examples=30)
@given(seeds)
def test_no_result_of_the_kalman_filter_moves_faster_than_a_hand(seed):
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.001, 0.05, 100))
    samples = np.cumsum(random.normal(0.0, 0.05, (100, 9)), axis=0)
    filter_ = Kalman()
    results = np.array([filter_.step(s, t) for s, t in zip(samples.tolist(), times.tolist())])
    for part, motion in ((slice(0, 3), PALM_MOTION), (slice(3, 9), ORIENTATION_MOTION)):
        speeds = np.linalg.norm(np.diff(results[:, part], axis=0), axis=1) / np.diff(times)
        assert np.max(speeds) <= motion.fastest * (1.0 + 1e-9)


@pytest.mark.parametrize("name", FILTERS)
@settings(max_examples=30)
@given(seeds, st.floats(-180.0, 180.0), st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))
def test_a_hand_turned_shifted_and_later_gives_the_result_turned_and_shifted(name, seed, a, b, c):
    random = np.random.default_rng(seed)
    R, shift, later = rotation_from_zyx(*np.radians([a, b, c])), random.normal(size=3), random.uniform(0.0, 1e5)
    times = np.cumsum(random.uniform(0.0, 0.04, 80))
    samples = np.cumsum(random.normal(0.0, 0.004, (80, 3, 3)), axis=0)
    plain, moved = FILTERS[name](), FILTERS[name]()
    for t, sample in zip(times.tolist(), samples):
        result = np.reshape(plain.step(sample.ravel().tolist(), t), (3, 3))
        there = sample @ R.T
        there[0] += shift
        expected = result @ R.T
        expected[0] += shift
        np.testing.assert_allclose(
            np.reshape(moved.step(there.ravel().tolist(), t + later), (3, 3)), expected, atol=1e-6
        )


def by_matrices(motion, samples, times):
    """The Kalman filter of a motion with random jerk and a tremor, by the discretised matrices (Van Loan, 1978)."""
    w, z = hand_filter.TREMOR_RAD_S, hand_filter.TREMOR_DAMPING
    A, noise = np.zeros((5, 5)), np.diag([0.0, 0.0, motion.jerk, 0.0, 4.0 * z * w])
    A[0, 1] = A[1, 2] = 1.0
    A[3, 4], A[4, 3], A[4, 4] = w, -w, -2.0 * z * w
    P, seen = np.diag([1.0, 1e2, 1e4, 1.0, 1.0]), np.array([1.0, 0.0, 0.0, 1.0, 0.0])
    x = np.zeros((5, samples.shape[1]))
    x[0] = samples[0]
    results = [x[0].copy()]
    for sample, dt in zip(samples[1:], np.diff(times)):
        block = np.block([[-A, noise], [np.zeros((5, 5)), A.T]]) * dt / 2.0**10
        E = sum(np.linalg.matrix_power(block, k) / np.prod(np.arange(1.0, k + 1.0)) for k in range(10))
        E = np.linalg.matrix_power(E, 2**10)
        F = E[5:, 5:].T
        x, P = F @ x, F @ P @ F.T + F @ E[:5, 5:]
        gain = P @ seen / (seen @ P @ seen + motion.sample_variance)
        x, P = x + np.outer(gain, sample - seen @ x), P - np.outer(gain, seen @ P)
        results.append(x[0].copy())
    return np.array(results)


@pytest.mark.parametrize("motion", [PALM_MOTION, ORIENTATION_MOTION], ids=["palm", "orientation"])
@settings(max_examples=10, deadline=None)
@given(seeds)
def test_the_kalman_filter_is_that_of_its_matrices(motion, seed):
    random = np.random.default_rng(seed)
    times, samples = np.cumsum(random.uniform(0.001, 0.08, 60)), random.normal(0.0, 0.1, (60, 3))
    free = MotionKalman(dataclasses.replace(motion, farthest=np.inf, fastest=np.inf))
    results = [free.step(s, t) for s, t in zip(samples.tolist(), times.tolist())]
    np.testing.assert_allclose(results, by_matrices(motion, samples, times), atol=1e-9)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("size", [10, 30])
def test_after_a_gap_the_result_is_there_in_two_steps(name, size, sample):
    average = HandAverage(size, name)
    for i in range(30):
        average.add(sample(position=(0.002 * i, 0.35, 0.0)), 0.01 * i)
    before = average.mean().palm[0]
    assert average.add(sample(position=(0.1, 0.35, 0.0)), 0.44) is None
    assert average.mean().palm[0] == pytest.approx(0.5 * (before + 0.1))
    average.add(sample(position=(0.1, 0.35, 0.0)), 0.45)
    assert average.mean().palm[0] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("name", FILTERS)
def test_a_hand_that_turns_over_has_no_frame_until_its_samples_agree(name, sample):
    average = HandAverage(10, name)
    for i in range(20):
        average.add(sample(), 0.01 * i)
    means = []
    for i in range(20, 100):
        average.add(sample(roll=170.0), 0.01 * i)
        means.append(average.mean())
    assert any(mean is None for mean in means)
    for mean in means:
        assert mean is None or max(sample(roll=r).normal @ mean.T_leap_hand[:3, 2] for r in (0.0, 170.0)) > 0.9
    np.testing.assert_allclose(means[-1].T_leap_hand[:3, 2], sample(roll=170.0).normal, atol=0.02)


def palms_of(filter_, size, times, palms, sample):
    """What the mean of `size` samples, or the filter, makes of palms, shape (n, 3) [m], once there is a result."""
    average, found = HandAverage(size, filter_), []
    for t, palm in zip(times.tolist(), palms):
        average.add(sample(position=palm), t)
        mean = average.mean()
        found.append(palm * np.nan if mean is None else mean.palm)
    return np.array(found)


SIZES, UP = st.integers(1, 100), np.array([0.0, 0.35, 0.0])


@pytest.mark.parametrize("name", ["mean", *FILTERS])
@settings(max_examples=8)
@given(seeds, st.integers(1, 50), st.integers(5, 50))
def test_a_larger_buffer_lets_less_noise_of_a_resting_hand_through(sample, name, seed, size, more):
    """Below FILTER_SIZE samples a filter is as it is: nothing is added to its delay there."""
    times = np.arange(round(6.0 * NOMINAL_RATE_HZ)) / NOMINAL_RATE_HZ
    palms = np.random.default_rng(seed).normal(0.0, 3e-4, (len(times), 3)) + UP
    size, larger = (size, size + more) if name == "mean" else (max(size, FILTER_SIZE), max(size, FILTER_SIZE) + more)
    errors = [(palms_of(name, n, times, palms, sample) - UP)[times > 2.0] for n in (size, larger)]
    assert np.square(errors[1]).mean() < np.square(errors[0]).mean()


@pytest.mark.parametrize("name", ["mean", *FILTERS])
@settings(max_examples=8)
@given(SIZES, st.floats(0.03, 0.3), st.sampled_from([25.0, 74.0, 110.0, 200.0]))
def test_the_delay_grows_by_half_a_frame_with_each_sample_of_the_buffer_and_no_further(sample, name, size, speed, rate):
    times = np.arange(0.0, 3.0, 1.0 / rate)
    palms = np.outer(speed * times, (1.0, 0.0, 0.0)) + UP
    least = 1 if name == "mean" else FILTER_SIZE
    lag, alone = (times[-1] - palms_of(name, n, times, palms, sample)[-1, 0] / speed for n in (size, least))
    samples = 1 + max(size - least, 0)
    averaged = min(samples, max(1, math.ceil(samples / NOMINAL_RATE_HZ * rate - 1e-9)))
    assert lag == pytest.approx(alone + 0.5 * (averaged - 1) / rate, abs=1e-3)


@pytest.mark.parametrize("name", FILTERS)
@given(seeds, st.integers(1, 10))
def test_up_to_the_shipped_buffer_a_filter_is_the_same_to_the_bit(sample, name, seed, size):
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.001, 0.15, 60))
    palms = np.cumsum(random.normal(0.0, 0.004, (60, 3)), axis=0) + UP
    alone, filter_ = FILTERS[name](), palms_of(name, size, times, palms, sample)
    result = before = None
    for t, palm, there in zip(times.tolist(), palms, filter_):
        hand = sample(position=palm)
        gap = before is not None and t - before > LONG_GAP_S
        if gap:
            alone.reset()
        last, result = result, list(alone.step([*hand.palm, *hand.direction, *hand.normal], t))
        result = [0.5 * (a + b) for a, b in zip(last, result)] if gap else result
        assert np.isnan(there[0]) or there.tolist() == result[:3]
        before = t

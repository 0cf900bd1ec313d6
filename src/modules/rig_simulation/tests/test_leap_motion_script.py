"""The scripted person moves smoothly, at human speed, and the same way for the same seed."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rig_simulation.devices.leap.sensing import LowPassNoise
from rig_simulation.operator.motion import CURL, FIGURES, PITCH, PLANES, ROLL, YAW, Script, Visit, _run

STEP_S = 0.002


@pytest.fixture(scope="module", params=[(figure, plane) for figure in FIGURES for plane in PLANES], ids="-".join)
def script(request):
    figure, plane = request.param
    return Script(figure=figure, plane=plane, size=150.0, speed=150.0)


@pytest.fixture(scope="module")
def visit(script):
    return Visit(script, np.random.default_rng(1))


@pytest.fixture(scope="module")
def sampled(visit):
    """Times, shape (n,) [s], and the states of the visit at them."""
    times = np.arange(0.0, visit.duration, STEP_S)
    return times, np.array([visit.state(t) for t in times])


def test_speed_and_acceleration_have_no_steps(script, sampled):
    _, states = sampled
    velocity = np.diff(states, axis=0) / STEP_S
    acceleration = np.diff(velocity, axis=0) / STEP_S
    jerk = np.diff(acceleration, axis=0) / STEP_S
    speed = np.linalg.norm(velocity[:, :3], axis=1)
    assert speed.max() < 1.61 * script.speed
    assert np.linalg.norm(acceleration[:, :3], axis=1).max() < 1000.0
    assert np.abs(jerk[:, :3]).max() < 20000.0, "a step of acceleration would show as a far higher jerk"
    assert np.degrees(np.abs(velocity[:, PITCH : ROLL + 1])).max() < 45.0
    assert np.abs(acceleration[:, CURL]).max() < 10.0


def test_a_visit_does_what_it_is_to_do(script, visit, sampled):
    times, states = sampled
    seen = states[[visit.visible(t) for t in times]]
    assert seen[0, 2] > 150.0
    assert seen[-1, 2] > 150.0
    assert_allclose(visit.state(visit.duration)[2], 320.0)
    assert 0.85 < seen[:, CURL].max() <= 1.0
    assert seen[-1, CURL] == 0.0
    assert np.degrees(np.abs(seen[:, [PITCH, YAW, ROLL]])).max() < 25.0
    across, along = np.array(PLANES[script.plane])
    assert_allclose(np.ptp(seen[:, :3] @ across), script.size, rtol=0.2)
    if script.plane == "upright" and script.figure != "line":
        height = {"circle": 1.0, "square": 1.0, "eight": 0.5}[script.figure] * script.size
        assert_allclose(np.ptp(seen[:, :3] @ along), height, rtol=0.3)


def test_the_hand_starts_flat_and_still_in_the_box(visit, sampled):
    times, states = sampled
    speed = np.linalg.norm(np.diff(states[:, :3], axis=0), axis=1) / STEP_S
    inside = np.abs(states[:-1, :3]).max(axis=1) < 100.0
    resting = times[:-1][(speed < 20.0) & inside & (times[:-1] > visit.appears)]
    first = states[np.searchsorted(times, resting[0] + 0.5)]
    assert np.abs(first[:3]).max() < 20.0
    assert np.degrees(np.abs(first[[PITCH, ROLL]])).max() < 10.0


def test_slower_people_take_longer():
    def duration(speed):
        return Visit(Script(speed=speed), np.random.default_rng(0)).duration

    assert duration(50.0) > 1.5 * duration(150.0) > 2.0 * duration(600.0)


def test_the_same_seed_gives_the_same_visit():
    a, b, c = (Visit(Script(), np.random.default_rng(seed)) for seed in (5, 5, 6))
    times = np.linspace(0.0, 20.0, 50)
    assert_allclose([a.state(t) for t in times], [b.state(t) for t in times], rtol=0, atol=0)
    assert np.abs(a.state(6.0) - c.state(6.0)).max() > 1e-3


def test_the_run_through_a_figure_is_monotonic_from_start_to_end():
    ways = [_run(part) for part in np.linspace(0.0, 1.0, 1001)]
    assert (ways[0], ways[-1]) == (0.0, 1.0)
    assert (np.diff(ways) >= 0.0).all()
    assert_allclose(ways[500], 0.5)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.86, 0.99])
def test_noise_has_unit_deviation_and_a_memory(memory):
    noise = LowPassNoise(np.random.default_rng(0), 50, memory)
    for _ in range(1000):
        noise.step()
    values = np.array([noise.step() for _ in range(4000)])
    assert_allclose(values.std(), 1.0, rtol=0.15)
    correlation = np.mean(values[1:] * values[:-1]) / np.mean(values**2)
    assert_allclose(correlation, 2.0 * memory / (1.0 + memory**2), atol=0.05)

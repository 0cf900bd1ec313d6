"""The device's clock: frames that waited get the time at which they were taken."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_motion.device_clock import MAX_WAIT_S, WINDOW_S, DeviceClock

START = 1.7e9  # seconds since 1970
PERIOD = 1.0 / 115.0


def stamps(clock, received, device=None):
    """Returns the stamps of frames taken every PERIOD, that are received at these times after START [s]."""
    device = PERIOD * np.arange(len(received)) if device is None else device
    return [at - clock.waited(round(1e6 * (5.0 + taken)), START + at) for at, taken in zip(received, device)]


def test_frames_that_come_in_bursts_keep_the_distances_of_the_device():
    taken = PERIOD * np.arange(230)
    received = 0.06 * np.ceil(taken / 0.06 - 1e-9) + 5e-4 * (np.arange(230) % 7)  # held back, then within 3 ms
    apart = np.diff(stamps(DeviceClock(), received))
    assert np.max(np.abs(apart - PERIOD)) < 4e-3
    assert np.max(np.diff(received)) > 0.05, "by their receipt they would be far apart"


@given(st.lists(st.floats(0.0, 0.3), min_size=2, max_size=60), st.floats(-0.02, 0.02))
def test_no_frame_is_newer_than_its_receipt_or_older_than_may_be_and_none_overtakes(waits, drift):
    received = np.maximum.accumulate(PERIOD * np.arange(len(waits)) + np.array(waits)) + 1e-4 * np.arange(len(waits))
    found = np.array(stamps(DeviceClock(), received, (1.0 + drift) * PERIOD * np.arange(len(waits))))
    assert np.all(found <= received + 1e-6) and np.all(received - found <= MAX_WAIT_S + 1e-6)
    assert np.all(np.diff(found) > 0.0)


@pytest.mark.parametrize(
    "device",
    [np.zeros(50), -PERIOD * np.arange(50), 2.0 * WINDOW_S * np.arange(50)],
    ids=["it stands", "it runs back", "it leaps"],
)
def test_a_clock_that_tells_nothing_changes_nothing(device):
    received = PERIOD * np.arange(50) + 0.01 * (np.arange(50) % 3)
    np.testing.assert_allclose(stamps(DeviceClock(), received, device), received, atol=1e-6)


def test_after_a_restart_of_the_device_and_a_step_of_the_own_clock_frames_count_anew():
    clock = DeviceClock()
    stamps(clock, PERIOD * np.arange(50))
    received = 10.0 + PERIOD * np.arange(50)
    np.testing.assert_allclose(stamps(clock, received), received, atol=1e-6)
    set_back = 2.0 + PERIOD * np.arange(50)
    np.testing.assert_allclose(stamps(clock, set_back, 20.0 + PERIOD * np.arange(50)), set_back, atol=1e-6)
    continues = 5.0 + PERIOD * np.arange(200)
    found = stamps(clock, continues, 20.0 + PERIOD * np.arange(50, 250))
    np.testing.assert_allclose(found, continues, atol=1e-6, err_msg="the own clock was set ahead")


def test_a_clock_that_drifts_is_followed():
    received = PERIOD * np.arange(2000)
    found = stamps(DeviceClock(), received, 0.999 * received)
    assert np.max(received - found) < 2e-3


@pytest.mark.parametrize(("late", "waited"), [(0.09, 0.09), (0.11, 0.1), (0.4, 0.1)])
def test_no_frame_counts_as_older_than_100_ms(late, waited):
    taken = PERIOD * np.arange(50)
    received = np.append(taken[:-1], taken[-1] + late)
    assert received[-1] - stamps(DeviceClock(), received)[-1] == pytest.approx(waited, abs=1e-5)

"""How fast the world's time passes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_simulation.world.clock import WINDOW_S, Pace


def test_before_two_moments_nothing_is_known():
    pace = Pace()
    assert pace.factor is None
    pace.add(1.0, 100.0)
    assert pace.factor is None
    pace.add(1.0, 100.0)
    assert pace.factor is None


@given(st.floats(0.01, 10.0), st.integers(1, 100))
def test_a_steady_world_has_its_speed_whenever_it_is_asked(speed, moments):
    pace = Pace()
    for i in range(moments + 1):
        pace.add(speed * 0.5 * i, 100.0 + 0.5 * i)
    assert pace.factor == pytest.approx(speed)


def test_what_is_long_past_does_not_count():
    pace = Pace()
    pace.add(0.0, 0.0)
    for i in range(20):
        pace.add(0.5 * i, 10.0 + i)
    assert pace.factor == pytest.approx(0.5)
    assert WINDOW_S < 10.0


def test_a_world_that_began_anew_is_compared_anew():
    pace = Pace()
    for world, now in ((50.0, 0.0), (51.0, 1.0), (0.5, 2.0), (1.5, 3.0)):
        pace.add(world, now)
    assert pace.factor == pytest.approx(1.0)

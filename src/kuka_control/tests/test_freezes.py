"""A controller on the simulated robot, which freezes at random times; all in virtual time."""

from __future__ import annotations

import random

import pytest
from link_world import bench

from common import clock


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.long) for seed in (3, 4))])
def test_no_freeze_shorter_than_the_patience_costs_the_link_or_the_state(seed):
    rng = random.Random(seed)
    with bench(seed) as one:
        begin = clock.monotonic() + rng.uniform(0.0, 6.0)
        end = begin + rng.choice([0.25, 0.7, 1.3, 2.5, 6.0])
        again = end + rng.uniform(0.0, 2.0)
        last = again + rng.choice([0.03, 0.1, 1.3])
        one.freeze((begin, end), (again, last))
        one.run(last + 0.5)
        one.control_on, one.enable_count = True, one.enable_count + 1
        one.run(last + 30.0, "servo")
        assert one.robot.stops == 0

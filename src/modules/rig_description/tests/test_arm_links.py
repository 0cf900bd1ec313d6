"""Which published mass properties are used: exactly those that can be true."""

from __future__ import annotations

import numpy as np
import pytest

from rig_description.arm_links import body, published, tube
from rig_description.arms import ARMS
from rig_description.rigid_body import fault


def lies_in(point, radius, bottom, top) -> bool:
    axis = top - bottom
    along = (point - bottom) @ axis / (axis @ axis)
    return 0.0 < along < 1.0 and np.linalg.norm(point - bottom - along * axis) < radius


@pytest.mark.parametrize("robot", ARMS)
@pytest.mark.parametrize("link", range(1, 8))
def test_published_numbers_are_replaced_where_they_cannot_be_true(robot, link):
    arm = ARMS[robot]
    numbers = published(arm, link)
    usable = fault(numbers) is None and lies_in(numbers.com, *tube(arm, link))
    assert usable == (link not in arm.unusable)
    assert fault(body(arm, link)) is None
    if usable:
        assert body(arm, link).mass == numbers.mass


@pytest.mark.parametrize("robot", ARMS)
def test_base_takes_the_rest_of_the_weight(robot):
    arm = ARMS[robot]
    assert body(arm, 0).mass > 4.0
    assert sum(body(arm, link).mass for link in range(8)) == pytest.approx(arm.mass)

"""Laws of rigid bodies; published mass properties are used exactly where they can be true."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_description.arms import ARMS, link_body, published, tube
from rig_description.rigid_body import Body, box, cylinder, joined, turned


def fault(body: Body) -> str | None:
    """Returns why no mass distribution can have these numbers, or None.

    The principal moments of a real body are positive and none exceeds the sum of the others. Equality belongs to a
    body without thickness and is refused too.
    """
    if not (np.isfinite(body.mass) and body.mass > 0.0):
        return f"the mass {body.mass} kg is not positive"
    if np.abs(body.inertia - body.inertia.T).max() > 1e-12:
        return "the inertia is not symmetric"
    least, middle, greatest = np.linalg.eigvalsh(body.inertia)
    if least <= 0.0:
        return f"the least principal moment {least:.3g} kg m^2 is not positive"
    if least + middle <= greatest * (1.0 + 1e-9):
        return f"the principal moments {least:.4g}, {middle:.4g}, {greatest:.4g} kg m^2 break the triangle inequality"
    return None


masses = st.floats(0.01, 50.0)
sizes = st.floats(0.005, 2.0)


@given(masses, sizes, sizes, sizes)
def test_plain_solids_can_exist(mass, a, b, c):
    assert fault(box(mass, (-a, -b, -c), (a, b, c))) is None
    assert fault(cylinder(mass, a, (0, 0, 0), (0, b, c))) is None


@given(masses, sizes, st.floats(0.1, 0.9))
def test_two_parts_of_a_cylinder_are_the_cylinder(mass, radius, share):
    whole = cylinder(mass, radius, (0, 0, 0), (0, 0, 1))
    parts = joined([
        cylinder(share * mass, radius, (0, 0, 0), (0, 0, share)),
        cylinder((1 - share) * mass, radius, (0, 0, share), (0, 0, 1)),
    ])  # fmt: skip
    np.testing.assert_allclose(parts.com, whole.com, atol=1e-9)
    np.testing.assert_allclose(parts.inertia, whole.inertia, rtol=1e-9, atol=1e-9)


def test_turned_body_lies_along_the_turned_axis():
    R = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    along_x = turned(cylinder(2.0, 0.1, (0, 0, 0), (0, 0, 1)), R)
    np.testing.assert_allclose(along_x.inertia, cylinder(2.0, 0.1, (0, 0, 0), (1, 0, 0)).inertia, atol=1e-12)
    np.testing.assert_allclose(along_x.com, [0.5, 0, 0])


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
    assert fault(link_body(arm, link)) is None
    if usable:
        assert link_body(arm, link).mass == numbers.mass


@pytest.mark.parametrize("robot", ARMS)
def test_base_takes_the_rest_of_the_weight(robot):
    arm = ARMS[robot]
    assert link_body(arm, 0).mass > 4.0
    assert sum(link_body(arm, link).mass for link in range(8)) == pytest.approx(arm.mass)

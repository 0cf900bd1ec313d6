"""Sets of angles against membership, tried angle by angle."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from iiwa_kinematics.arcs import CIRCLE, TURN, intersection, nearest, positive, remaining

ANGLES = np.linspace(-math.pi, math.pi, 721)
EDGE = 1e-9
coefficients = st.floats(-2.0, 2.0)
arcs = st.tuples(st.floats(-10.0, 10.0), st.floats(0.0, TURN))


def inside(arc, angle):
    """1 inside, 0 outside, None too near to an end to tell."""
    start, length = arc
    offset = (angle - start) % TURN
    if min(offset, TURN - offset, abs(offset - length)) < EDGE:
        return None
    return int(offset < length)


@given(coefficients, coefficients, coefficients)
def test_arc_is_where_the_sinusoid_is_positive(a, b, c):
    arc = positive(a, b, c)
    for angle in ANGLES:
        value = a * math.cos(angle) + b * math.sin(angle) + c
        if abs(value) > 1e-6:
            assert (value > 0.0) == (arc is not None and inside(arc, angle) != 0)


def test_flat_sinusoids():
    assert positive(0.0, 0.0, 0.0) is None
    assert positive(1e-17, 1e-17, 1e-17) is None
    assert positive(0.0, 0.0, 1.0) == CIRCLE
    assert positive(1.0, 0.0, 1.0 + 1e-12) == CIRCLE
    assert positive(1.0, 0.0, -1.0) is None


def test_two_sinusoids_that_leave_a_single_angle_leave_it_in_spite_of_rounding_errors():
    for zero in ANGLES:
        c, s = math.cos(zero), math.sin(zero)
        touching = [positive(-c, -s, 1.0 + 4e-16)]
        meeting = [positive(s, -c, 4e-16), positive(-s, c, 4e-16)]
        for arcs in (touching, meeting):
            free = remaining([arc for arc in arcs if arc is not None])
            assert any(min((low - zero) % TURN, (zero - low) % TURN) < 1e-6 for low, _ in free)


@given(arcs, arcs)
def test_intersection_is_in_both(first, second):
    common = intersection(first, second)
    for angle in ANGLES:
        expected = inside(first, angle), inside(second, angle)
        if None not in expected:
            assert any(inside(arc, angle) != 0 for arc in common) == all(expected)


@given(st.lists(arcs, max_size=5))
def test_remaining_is_in_none(forbidden):
    free = remaining(forbidden)
    for low, high in free:
        assert -math.pi <= low <= math.pi and low <= high <= low + TURN + EDGE
    for angle in ANGLES:
        states = [inside(arc, angle) for arc in forbidden]
        if None not in states:
            assert any((angle - low) % TURN <= high - low + EDGE for low, high in free) == (not any(states))


@given(st.floats(-math.pi, math.pi), st.floats(0.0, TURN - 1e-3), st.floats(-20.0, 20.0))
def test_nearest_is_in_the_interval_and_none_is_nearer(low, length, angle):
    def distance(a):
        return abs((a - angle + math.pi) % TURN - math.pi)

    found = nearest((low, low + length), angle)
    assert low - EDGE <= found <= low + length + EDGE
    others = np.linspace(low, low + length, 50)
    assert distance(found) <= min(map(distance, others)) + EDGE

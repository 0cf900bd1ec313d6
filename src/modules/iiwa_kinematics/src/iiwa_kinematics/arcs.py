"""Sets of angles on the circle, and the angles at which a sinusoid is positive: a joint limit forbids the arm angles at
which one sinusoid, or two at once, are positive. All in closed form.

An arc is (start, length): the angles from `start` to `start + length` [rad]; length 2 pi is the whole circle. An
interval is (low, high) with -pi <= low <= pi and low <= high < low + 2 pi, so that one that contains pi runs beyond
it."""

from __future__ import annotations

import math
from typing import Tuple

TURN = 2.0 * math.pi
Sinusoid = Tuple[float, float, float]  # (a, b, c): the function a cos(angle) + b sin(angle) + c
Arc = Tuple[float, float]
Interval = Tuple[float, float]
CIRCLE: Arc = (-math.pi, TURN)
FLAT = 1e-12  # sinusoids with a smaller amplitude do not depend on the angle


def positive(a: float, b: float, c: float) -> Arc | None:
    """Returns the arc on which the sinusoid (a, b, c) is positive, None if it is so nowhere."""
    # A sinusoid counts as positive above this. Where several joints are at their limits at once, the limits leave a
    # single angle free; rounding errors of a few 1e-16 in each would close it.
    rounding = 1e-13
    c, amplitude = c - rounding, math.hypot(a, b)
    if c <= -amplitude or (amplitude < FLAT and c < FLAT):
        return None
    if c >= amplitude:
        return CIRCLE
    half = math.acos(-c / amplitude)
    return math.atan2(b, a) - half, 2.0 * half


def intersection(first: Arc, second: Arc) -> list[Arc]:
    """Returns the arcs, two at most, that lie in both."""
    length_1, length_2 = first[1], second[1]
    offset = (second[0] - first[0]) % TURN
    arcs = []
    if offset < length_1:
        arcs.append((first[0] + offset, min(length_1 - offset, length_2)))
    if offset + length_2 > TURN:
        arcs.append((first[0], min(length_1, offset + length_2 - TURN)))
    return arcs


def remaining(forbidden: list[Arc]) -> list[Interval]:
    """Returns the intervals of the circle that no forbidden arc covers; their ends belong to them."""
    pieces = []
    for start, length in forbidden:
        if length >= TURN:
            return []
        start = (start + math.pi) % TURN - math.pi
        end = start + length
        if end > math.pi:
            pieces.append((start, math.pi))
            pieces.append((-math.pi, end - TURN))
        else:
            pieces.append((start, end))
    if not pieces:
        return [(-math.pi, math.pi)]
    pieces.sort()
    free, reached = [], -math.pi
    for start, end in pieces:
        if start > reached:
            free.append((reached, start))
        reached = max(reached, end)
    if reached < math.pi:
        free.append((reached, math.pi))
    if len(free) > 1 and free[0][0] == -math.pi and free[-1][1] == math.pi:
        return [*free[1:-1], (free[-1][0], free[0][1] + TURN)]
    return free


def nearest(interval: Interval, angle: float) -> float:
    """Returns the angle of the interval that is nearest to `angle`; equal to `angle` (mod 2 pi) if that lies inside."""
    low, high = interval
    beyond = (angle - low) % TURN
    if beyond <= high - low:
        return low + beyond
    return high if beyond - (high - low) < TURN - beyond else low

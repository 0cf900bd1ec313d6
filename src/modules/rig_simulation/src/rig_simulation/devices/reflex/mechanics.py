"""The mechanics of the hand: spools wind tendons, tendons turn the links of the fingers.

`Mechanics` is the interface for the electronics of the simulated hand. `FreeMechanics` is the hand in free space, with
kinematics alone; the physical world has one with masses and contacts. Fingers count from 0 (f1, f2, f3), motors too
(f1, f2, f3, preshape). Angles in rad, 0 = open.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

KNUCKLE_FRACTION = 1 / 1.4
"""Fraction of the tendon's turn that the knuckle takes, the outer link the rest; once the inner link is blocked, the
outer link takes all further turn."""

TAXELS = 9
FINGERS = 3


class Mechanics(Protocol):
    """The moving parts of one hand."""

    def pull(self, spools: Sequence[float]) -> None:
        """Takes the spool angles of the four motors; below 0 a finger's tendon is slack."""

    def resistance(self, motor: int) -> float:
        """Returns the closing effort [0.1 %] that a motor needs to hold its position."""

    def proximal(self, finger: int) -> float:
        """Returns the turn of a knuckle."""

    def distal(self, finger: int) -> float:
        """Returns the bend of a finger's outer link."""

    def touch(self, finger: int) -> Sequence[float]:
        """Returns the pressure on the nine taxels of a finger [counts]."""

    def block(self, finger: int, proximal: float | None) -> None:
        """Limits the turn of a knuckle; None removes the limit."""


class FreeMechanics:
    """A hand in free space."""

    def __init__(self) -> None:
        self._ends = [math.pi] * FINGERS
        self._proximal = [0.0] * FINGERS
        self._distal = [0.0] * FINGERS

    def pull(self, spools: Sequence[float]) -> None:
        """Turns the links of the fingers."""
        for finger, end in enumerate(self._ends):
            tendon = max(0.0, spools[finger])
            self._proximal[finger] = min(tendon * KNUCKLE_FRACTION, end)
            self._distal[finger] = tendon - self._proximal[finger]

    def resistance(self, motor: int) -> float:
        """Returns 0: the links weigh nothing."""
        return 0.0

    def proximal(self, finger: int) -> float:
        """Returns the turn of a knuckle."""
        return self._proximal[finger]

    def distal(self, finger: int) -> float:
        """Returns the bend of a finger's outer link."""
        return self._distal[finger]

    def touch(self, finger: int) -> Sequence[float]:
        """Returns zeros."""
        return (0.0,) * TAXELS

    def block(self, finger: int, proximal: float | None) -> None:
        """Limits the turn of a knuckle."""
        self._ends[finger] = math.pi if proximal is None else proximal

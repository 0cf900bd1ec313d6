"""Which law the robot's servo loop has, told by a small motion of the last joint, out and back.

The goal turns joint 7 by half a degree and rests there. An arm that goes straight for its goal works off the rest by
the same share in every moment; under the LTS law (servo_law.py) ever more slowly: from a half to an eighth of the way
it takes about 0.04 s in one case and 0.7 s in the other, with drives of 40 ms. Between the two the answer is unclear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import read_only

TURN_RAD = float(np.radians(0.5))
"""How far joint 7 turns; the tool point stands on its axis and does not move."""

RAMP_S = 0.06
"""The goal goes out, and back, in this time [s]."""

STRAIGHT_S = 0.12
"""An arm that needs no longer than this from a half to an eighth goes straight for its goal [s]."""

LTS_S = 0.25
"""An arm that needs longer than this follows the LTS law [s]."""

PATIENCE_S = 2.0
"""Each way ends after this time at the latest [s]."""

ELSEWHERE_RAD = 0.25 * TURN_RAD
"""Other joints do not move; further than this, something else moves the arm [rad]."""


@dataclass(frozen=True)
class Checked:
    """A step of the check.

    Attributes:
        goal: to be sent, shape (7,) [rad].
        done: whether the check has ended.
        law: "lts", "none", or None while or where it is unclear.
        seen: what was seen, part of a sentence.
    """

    goal: np.ndarray
    done: bool = False
    law: str | None = None
    seen: str = ""


class LawCheck:
    """Watches a small motion from the joints q, shape (7,) [rad]."""

    def __init__(self, q: np.ndarray) -> None:
        self._rest = read_only(q)
        self._turn = -TURN_RAD if q[6] > 0.0 else TURN_RAD
        self._began: float | None = None
        self._back_at: float | None = None
        self._half_at: float | None = None
        self._eighth_at: float | None = None
        self._disturbed = False

    def step(self, measured: np.ndarray, now: float) -> Checked:
        """Returns the goal of this moment, and the answer at the end.

        Args:
            measured: joints of the arm, shape (7,) [rad].
            now: monotonic time [s].
        """
        if self._began is None:
            self._began = now
        left = 1.0 - (measured[6] - self._rest[6]) / self._turn
        self._disturbed |= bool(np.max(np.abs(measured - self._rest)[:6]) > ELSEWHERE_RAD)
        if self._back_at is None:
            return self._outwards(left, now - self._began, now)
        back = now - self._back_at
        if (back > 2.0 * RAMP_S and 1.0 - left <= 0.125) or back > PATIENCE_S:
            return Checked(self._rest, True, *self._answer())
        return self._at(1.0 - min(back / RAMP_S, 1.0))

    def _outwards(self, left: float, elapsed: float, now: float) -> Checked:
        if left <= 0.5 and self._half_at is None:
            self._half_at = now
        if left <= 0.125:
            self._eighth_at = now
        if self._eighth_at is not None or elapsed > PATIENCE_S:
            self._back_at = now
        return self._at(min(elapsed / RAMP_S, 1.0))

    def _at(self, part: float) -> Checked:
        """Returns the goal after a part of the turn; it starts and stops smoothly."""
        goal = self._rest.copy()
        goal[6] += self._turn * part * part * (3.0 - 2.0 * part)
        return Checked(read_only(goal))

    def _answer(self) -> tuple[str | None, str]:
        if self._disturbed:
            return None, "joints moved that were not to move"
        if self._half_at is None or self._eighth_at is None:
            return None, f"joint 7 did not get through its test motion of 0.5 deg within {PATIENCE_S:g} s"
        needed = self._eighth_at - self._half_at
        seen = f"joint 7 took {needed:.2f} s for the last part of its test motion of 0.5 deg"
        if needed <= STRAIGHT_S:
            return "none", seen
        return ("lts" if needed > LTS_S else None), seen

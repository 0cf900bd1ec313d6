"""The identification of the robot's servo law by a small motion of the last joint, out and back.

The goal turns joint 7 by half a degree and rests there. An arm that goes straight for its goal works off the rest by
the same fraction in every moment; under the LTS law (servo_law.py) ever more slowly: from a half to an eighth of the
motion it takes about 0.04 s in one case and 0.7 s in the other, with drives of 40 ms. Between the two the result is
unclear.
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
"""The motion out, and the one back, are given up after this time [s]."""

ELSEWHERE_RAD = 0.25 * TURN_RAD
"""If another joint moves further than this, something else moves the arm [rad]."""


@dataclass(frozen=True)
class ServoLawResult:
    """What the motion showed: `law` is "lts", "none", or None if it is unclear; `evidence` is a part of a sentence."""

    law: str | None
    evidence: str


@dataclass(frozen=True)
class ServoLawVerdict:
    """What follows from it.

    Attributes:
        lts: whether goals are to be made for the LTS law.
        level, sentence: what is to be reported.
        refused: whether the arm must not follow goals.
    """

    lts: bool
    level: str
    sentence: str
    refused: bool = False


def verdict(result: ServoLawResult, servo_law: str) -> ServoLawVerdict:
    """Returns what follows from a result for the parameter servo_law, "lts" or "none"."""
    law, evidence = result.law, result.evidence
    if law is None:
        without = " Goals are sent as for servo_law none." if servo_law == "lts" else ""
        return ServoLawVerdict(
            False, "warn", f"The servo law of the robot's controller is unclear: {evidence}.{without}"
        )
    if law == servo_law:
        sentence = f"The servo law of the robot's controller is {law}, as set: {evidence}."
        return ServoLawVerdict(law == "lts", "info", sentence)
    if servo_law == "none":
        sentence = (
            f"The robot's controller shows the servo law lts ({evidence}); with the parameter servo_law: lts the arm "
            "would follow closer."
        )
        return ServoLawVerdict(False, "info", sentence)
    sentence = (
        f"The parameter servo_law is lts, but the robot's controller goes straight for its goals ({evidence}); with "
        "lts they would be far too large. Set servo_law: none."
    )
    return ServoLawVerdict(False, "error", sentence, refused=True)


class ServoLawIdentification:
    """Watches a small motion from the joints q, shape (7,) [rad]."""

    def __init__(self, q: np.ndarray) -> None:
        self._rest = read_only(q)
        self._turn = -TURN_RAD if q[6] > 0.0 else TURN_RAD
        self._began: float | None = None
        self._back_at: float | None = None
        self._half_at: float | None = None
        self._eighth_at: float | None = None
        self._disturbed = False

    def step(self, measured: np.ndarray, now: float) -> tuple[np.ndarray, ServoLawResult | None]:
        """Returns the goal of this moment, shape (7,) [rad], and at the end the result.

        Args:
            measured: joints of the arm, shape (7,) [rad].
            now: monotonic time [s].
        """
        if self._began is None:
            self._began = now
        left = 1.0 - (measured[6] - self._rest[6]) / self._turn
        self._disturbed |= bool(np.max(np.abs(measured - self._rest)[:6]) > ELSEWHERE_RAD)
        if self._back_at is None:
            return self._outwards(left, now - self._began, now), None
        back = now - self._back_at
        if (back > 2.0 * RAMP_S and 1.0 - left <= 0.125) or back > PATIENCE_S:
            return self._rest, self._result()
        return self._goal(1.0 - min(back / RAMP_S, 1.0)), None

    def _outwards(self, left: float, elapsed: float, now: float) -> np.ndarray:
        if left <= 0.5 and self._half_at is None:
            self._half_at = now
        if left <= 0.125:
            self._eighth_at = now
        if self._eighth_at is not None or elapsed > PATIENCE_S:
            self._back_at = now
        return self._goal(min(elapsed / RAMP_S, 1.0))

    def _goal(self, part: float) -> np.ndarray:
        """Returns the goal after a part of the turn; it starts and stops smoothly."""
        goal = self._rest.copy()
        goal[6] += self._turn * part * part * (3.0 - 2.0 * part)
        return read_only(goal)

    def _result(self) -> ServoLawResult:
        if self._disturbed:
            return ServoLawResult(None, "joints moved that were not to move")
        if self._half_at is None or self._eighth_at is None:
            return ServoLawResult(
                None, f"joint 7 did not get through its test motion of 0.5 deg within {PATIENCE_S:g} s"
            )
        needed = self._eighth_at - self._half_at
        evidence = f"joint 7 took {needed:.2f} s for the last part of its test motion of 0.5 deg"
        if needed <= STRAIGHT_S:
            return ServoLawResult("none", evidence)
        return ServoLawResult("lts" if needed > LTS_S else None, evidence)

"""The law of the robot's servo loop, the goal that makes the arm go to the wanted joints, and the law's identification.

Every millisecond the loop gives the drives a destination: measured joint + f(goal - measured joint). The published
server has f(e) = sign(e) a (1 - exp(-(e/b)^2)), here called LTS; one build of it has f(e) = e. Under the LTS law small
distances vanish ever more slowly. A goal of measured joint + f^-1(wanted step) makes the destination the wanted one.
(Source: docs/handbook/wire-protocols.md, "Servo mode".)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from kuka_control.limits.motion_limits import GAP_S

REACH_RAD = 0.07  # a: the greatest step of the loop in one cycle [rad]
WIDTH_RAD = 0.0525  # b: a distance of this size gives a step of 63 % of the reach [rad]
STEP_RAD = 0.9 * REACH_RAD  # the greatest step that is requested: a goal is at most 1.5 b away from the arm [rad]
NOISE_RAD = 2e-5  # below this step the inverse is linear: noise would make its infinite slope at zero oscillate [rad]
EXTRAPOLATED_S = 0.02  # joints are extrapolated by at most this [s]
ARM_S = 0.03  # mean delay between the speeds of goal and arm [s]; for drives with a time constant of 40 ms
TURN_RAD = float(np.radians(0.5))  # how far joint 7 turns; the tool point stands on its axis and does not move
RAMP_S = 0.06  # the goal goes out, and back, in this time [s]
STRAIGHT_S = 0.12  # an arm that needs no longer than this from a half to an eighth goes straight for its goal [s]
LTS_S = 0.25  # an arm that needs longer than this follows the LTS law [s]
PATIENCE_S = 2.0  # the motion out, and the one back, are given up after this time [s]
ELSEWHERE_RAD = 0.25 * TURN_RAD  # if another joint moves further than this, something else moves the arm [rad]


def lts(error: np.ndarray) -> np.ndarray:
    """Returns the step f(e) [rad] that the LTS law makes of a distance e to the goal [rad]."""
    return np.copysign(-REACH_RAD * np.expm1(-((error / WIDTH_RAD) ** 2)), error)


def lts_inverse(step: float) -> float:
    """Returns the distance e [rad] for which the LTS law makes a step [rad].

    Steps beyond STEP_RAD count as STEP_RAD, those below NOISE_RAD give a proportional distance.
    """
    size = min(abs(step), STEP_RAD)
    if size < NOISE_RAD:
        return AT_NOISE_RAD / NOISE_RAD * step
    return math.copysign(WIDTH_RAD * math.sqrt(-math.log1p(-size / REACH_RAD)), step)


AT_NOISE_RAD = WIDTH_RAD * math.sqrt(-math.log1p(-NOISE_RAD / REACH_RAD))  # the distance for a step of NOISE_RAD [rad]


class LtsGoals:
    """Goals with which a server of the LTS law reaches the wanted joints, from the start of servo mode on.

    The measured joints are some milliseconds old, while the loop uses the present ones. They are extrapolated at the
    speed that the goal had a moment ago. The remaining error is of second order: near the goal f is flat.

    Args:
        lower, upper: joint ranges, shape (7,) [rad], that no goal leaves.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray) -> None:
        self._ranges = list(zip(lower.tolist(), upper.tolist()))
        self._measured: np.ndarray | None = None
        self._age = 0.0
        self._speed = [0.0] * 7

    def step(self, wanted: np.ndarray, speed: np.ndarray, measured: np.ndarray, dt: float) -> np.ndarray:
        """Returns the goal to send, shape (7,) [rad], for the wanted joints [rad] and their speed [rad/s].

        `measured` are the newest known joints, the same object until newer ones come; `dt` is the time since the last
        call [s].
        """
        if measured is not self._measured:
            self._measured, self._age = measured, 0.0
        self._age = min(self._age + max(dt, 0.0), EXTRAPOLATED_S)
        part = min(max(dt, 0.0) / ARM_S, 1.0)
        self._speed = [before + (v - before) * part for before, v in zip(self._speed, speed.tolist())]
        goals = []
        for q, v, goal, (lower, upper) in zip(measured.tolist(), self._speed, wanted.tolist(), self._ranges):
            present = q + min(max(self._age * v, -STEP_RAD), STEP_RAD)
            goals.append(min(max(present + lts_inverse(goal - present), lower), upper))
        return read_only(goals)


@dataclass(frozen=True)
class ServoLawResult:
    """What the motion showed: `law` is "lts", "none", or None if it is unclear; `evidence` is a part of a sentence."""

    law: str | None
    evidence: str


@dataclass(frozen=True)
class ServoLawVerdict:
    """What follows from it."""

    lts: bool  # whether goals are to be made for the LTS law
    level: str  # of what is to be reported
    sentence: str  # that is to be reported
    refused: bool = False  # whether the arm must not follow goals


def verdict(result: ServoLawResult, servo_law: str) -> ServoLawVerdict:
    """Returns what follows from a result for the parameter servo_law, "lts" or "none"."""
    law, evidence = result.law, result.evidence
    if law is None:
        without = " Goals are sent as for servo_law none." if servo_law == "lts" else ""
        sentence = f"The servo law of the robot's controller is unclear: {evidence}.{without}"
        return ServoLawVerdict(False, "warn", sentence)
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
    """Watches a small motion of the last joint, out and back, from the joints q, shape (7,) [rad].

    The goal turns joint 7 by half a degree and rests there. An arm that goes straight for its goal works off the rest
    by the same fraction in every moment; under the LTS law ever more slowly: from a half to an eighth of the motion it
    takes about 0.04 s in one case and 0.7 s in the other, with drives of 40 ms. Between the two it is unclear.
    """

    def __init__(self, q: np.ndarray) -> None:
        self._rest = read_only(q)
        self._turn = -TURN_RAD if q[6] > 0.0 else TURN_RAD
        self._began: float | None = None
        self._back_at: float | None = None
        self._half_at: float | None = None
        self._eighth_at: float | None = None
        self._disturbed = self._stalled = False
        self._looked = 0.0

    def step(self, measured: np.ndarray, now: float) -> tuple[np.ndarray, ServoLawResult | None]:
        """Returns the goal, shape (7,) [rad], and at the end the result; `now` is monotonic [s]."""
        if self._began is None:
            self._began = now
        elif now - self._looked > GAP_S:
            self._stalled = True
        self._looked = now
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
        if self._stalled:
            return ServoLawResult(None, f"for more than {GAP_S:g} s of it nobody looked at the arm")
        if self._half_at is None or self._eighth_at is None:
            slow = f"joint 7 did not get through its test motion of 0.5 deg within {PATIENCE_S:g} s"
            return ServoLawResult(None, slow)
        needed = self._eighth_at - self._half_at
        evidence = f"joint 7 took {needed:.2f} s for the last part of its test motion of 0.5 deg"
        if needed <= STRAIGHT_S:
            return ServoLawResult("none", evidence)
        return ServoLawResult("lts" if needed > LTS_S else None, evidence)

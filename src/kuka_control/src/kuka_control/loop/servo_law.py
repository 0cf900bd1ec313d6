"""The law of the robot's servo loop, the goal that makes the arm go to the wanted joints, and the law's identification.

Every millisecond the loop gives the drives a destination: measured joint + f(goal - measured joint). The published
server has f(e) = sign(e) a (1 - exp(-(e/b)^2)), here called LTS, by which small distances vanish ever more slowly; one
build has f(e) = e. A goal of measured joint + f^-1(wanted step) makes the destination the wanted one. (Source:
docs/handbook/wire-protocols.md, "Servo mode".)"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from kuka_control.numbers import GAP_S

REACH_RAD = 0.07  # a: the greatest step of the loop in one cycle [rad]
WIDTH_RAD = 0.0525  # b: a distance of this size gives a step of 63 % of the reach [rad]
STEP_RAD = 0.9 * REACH_RAD  # the greatest step that is requested: a goal is at most 1.5 b away from the arm [rad]
NOISE_RAD = 2e-5  # below this step the inverse is linear: noise would make its infinite slope at zero oscillate [rad]
EXTRAPOLATED_S = 0.02  # joints are extrapolated by at most this [s]
TURN_RAD = float(np.radians(0.5))  # how far joint 7 turns; the tool point stands on its axis and does not move
PATIENCE_S = 2.0  # the motion out, and the one back, are given up after this time [s]


def lts(error: np.ndarray) -> np.ndarray:
    """Returns the step f(e) [rad] that the LTS law makes of a distance e to the goal [rad]."""
    return np.copysign(-REACH_RAD * np.expm1(-((error / WIDTH_RAD) ** 2)), error)


def lts_inverse(step: float) -> float:
    """Returns the distance e [rad] for which the LTS law makes a step [rad]. Steps beyond STEP_RAD count as
    STEP_RAD, those below NOISE_RAD give a proportional distance."""
    size = min(abs(step), STEP_RAD)
    if size < NOISE_RAD:
        return AT_NOISE_RAD / NOISE_RAD * step
    return math.copysign(WIDTH_RAD * math.sqrt(-math.log1p(-size / REACH_RAD)), step)


AT_NOISE_RAD = WIDTH_RAD * math.sqrt(-math.log1p(-NOISE_RAD / REACH_RAD))  # the distance for a step of NOISE_RAD [rad]


class LtsGoals:
    """Goals with which a server of the LTS law reaches the wanted joints, from the start of servo mode on. The measured
    joints, some milliseconds old, are extrapolated at the speed that the goal had a moment ago; the error that is left
    is of second order. No goal leaves the joint ranges `lower`, `upper`, shape (7,) [rad]."""

    def __init__(self, lower: np.ndarray, upper: np.ndarray) -> None:
        self._ranges = list(zip(lower.tolist(), upper.tolist()))
        self._measured: np.ndarray | None = None
        self._age = 0.0
        self._speed = [0.0] * 7

    def step(self, wanted: np.ndarray, speed: np.ndarray, measured: np.ndarray, dt: float) -> np.ndarray:
        """Returns the goal to send, shape (7,) [rad], for the wanted joints [rad] and their speed [rad/s].
        `measured` are the newest known joints, the same object until newer ones come; `dt` is the time since the
        last call [s]."""
        if measured is not self._measured:
            self._measured, self._age = measured, 0.0
        self._age = min(self._age + max(dt, 0.0), EXTRAPOLATED_S)
        delay = 0.03  # mean one between the speeds of goal and arm, for drives with a time constant of 40 ms [s]
        part = min(max(dt, 0.0) / delay, 1.0)
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
    badly_seen: bool = False  # whether the arm moved, and the motion may show more when it is repeated


@dataclass(frozen=True)
class ServoLawVerdict:
    lts: bool  # whether goals are to be made for the LTS law
    level: str  # of what is to be reported
    sentence: str  # that is to be reported
    refused: bool = False  # whether the arm must not follow goals


def verdict(result: ServoLawResult, servo_law: str) -> ServoLawVerdict:
    """Returns what follows from a result for the parameter servo_law, "auto", "lts" or "none"."""
    law, evidence = result.law, result.evidence
    if law is None:
        without = " Goals are sent as for servo_law none." if servo_law != "none" else ""
        sentence = f"The servo law of the robot's controller is unclear: {evidence}.{without}"
        return ServoLawVerdict(False, "warn", sentence)
    if servo_law in (law, "auto"):
        as_set = "" if servo_law == "auto" else ", as set"
        sentence = f"The servo law of the robot's controller is {law}{as_set}: {evidence}."
        return ServoLawVerdict(law == "lts", "info", sentence)
    if servo_law == "none":
        sentence = (
            f"The robot's controller shows the servo law lts ({evidence}); with the parameter servo_law: auto the arm "
            "would follow closer."
        )
        return ServoLawVerdict(False, "info", sentence)
    sentence = (
        f"The parameter servo_law is lts, but the robot's controller goes straight for its goals ({evidence}); with "
        "lts they would be far too large. Set servo_law: none."
    )
    return ServoLawVerdict(False, "error", sentence, refused=True)


class Approach:
    """The approach of the last joint to a resting goal, from its remaining part of the way at each look."""

    MARKS = (0.5, 0.25, 0.125)

    def __init__(self) -> None:
        self._times: list[float] = []  # when the remaining part was first at most the marks [s]
        self._left = 1.0
        self._step = 0.0  # largest one between the first and the last mark

    @property
    def done(self) -> bool:
        return len(self._times) == len(self.MARKS)

    def look(self, left: float, now: float) -> None:
        """Adds the remaining part of the way at a time [s]."""
        if self._times and not self.done:
            self._step = max(self._step, self._left - left)
        self._left = left
        while not self.done and left <= self.MARKS[len(self._times)]:
            self._times.append(now)

    @property
    def needed(self) -> float:
        """The time from a half to an eighth [s]."""
        return self._times[2] - self._times[0]

    @property
    def law(self) -> str | None:
        """The law that it shows: "lts", "none", or None if it is unclear."""
        straight = 0.12  # an arm that needs no longer than this from a half to an eighth goes straight for its goal [s]
        slow = 0.25  # an arm that follows the LTS law needs longer than this [s]
        well_seen = 0.06  # the largest step between two looks in that time, as a part of the turn
        if self.needed <= straight:
            return "none"
        # Under the LTS law the time from a quarter to an eighth is twice that from a half to a quarter, whatever the
        # drives. An arm that goes straight for its goal, however slowly, needs the same time for both, one at constant
        # speed half.
        first = self._times[1] - self._times[0]
        second = self._times[2] - self._times[1]
        like_lts = 1.4 * first <= second <= 3.0 * first and self._step <= well_seen
        return "lts" if self.needed > slow and like_lts else None


class ServoLawIdentification:
    """Watches a small motion of joint 7, out and back by half a degree, from the joints q, shape (7,) [rad]. An arm
    that goes straight for its goal works off the rest by the same fraction in every moment; under the LTS law ever more
    slowly: from a half to an eighth of the motion 0.04 s and 0.7 s, with drives of 40 ms. The LTS law is sure only if
    the times to a quarter and to an eighth fit it too, both ways; otherwise the law is unclear."""

    def __init__(self, q: np.ndarray) -> None:
        self.rest = read_only(q)
        self._turn = -TURN_RAD if q[6] > 0.0 else TURN_RAD
        self._began: float | None = None
        self._back_at: float | None = None
        self._out = Approach()
        self._back = Approach()
        self._way_back = 1.0  # as a part of the turn
        self._disturbed = self._stalled = False
        self._looked = 0.0

    def step(self, measured: np.ndarray, now: float) -> tuple[np.ndarray, ServoLawResult | None]:
        """Returns the goal, shape (7,) [rad], and at the end the result; `now` is monotonic [s]."""
        if self._began is None:
            self._began = now
        elif now - self._looked > GAP_S:
            self._stalled = True
        self._looked = now
        left = float(1.0 - (measured[6] - self.rest[6]) / self._turn)
        elsewhere = 0.25 * TURN_RAD  # if another joint moves further than this, something else moves the arm [rad]
        ramp = 0.06  # the goal goes out, and back, in this time [s]
        self._disturbed |= bool(np.max(np.abs(measured - self.rest)[:6]) > elsewhere)
        if self._back_at is None:
            self._out.look(left, now)
            if self._out.done or now - self._began > PATIENCE_S:
                self._back_at = now
                self._way_back = max(1.0 - left, 1e-3)
            return self._goal(min((now - self._began) / ramp, 1.0)), None
        back = now - self._back_at
        self._back.look((1.0 - left) / self._way_back, now)
        if (back > 2.0 * ramp and self._back.done) or back > PATIENCE_S:
            return self.rest, self._result()
        return self._goal(1.0 - min(back / ramp, 1.0)), None

    def _goal(self, part: float) -> np.ndarray:
        """Returns the goal after a part of the turn; it starts and stops smoothly."""
        goal = self.rest.copy()
        goal[6] += self._turn * part * part * (3.0 - 2.0 * part)
        return read_only(goal)

    def _result(self) -> ServoLawResult:
        if self._disturbed:
            return ServoLawResult(None, "joints moved that were not to move")
        if self._stalled:
            return ServoLawResult(None, f"for more than {GAP_S:g} s of it nobody looked at the arm", True)
        if not (self._out.done and self._back.done):
            slow = f"joint 7 did not get through its test motion of 0.5 deg within {PATIENCE_S:g} s"
            return ServoLawResult(None, slow)
        evidence = f"joint 7 took {self._out.needed:.2f} s for the last part of its test motion of 0.5 deg"
        law = self._out.law if self._out.law == self._back.law else None
        return ServoLawResult(law, evidence, law is None)

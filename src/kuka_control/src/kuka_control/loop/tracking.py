"""Whether measured joints can be true, whether the arm follows its servo goals, and what holds it in PTP motions."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from kst import PtpApproach
from kuka_control.loop.commands import Event
from kuka_control.numbers import (
    FAR_RAD,
    FAR_S,
    FASTER,
    HELD_AT_ENDS_S,
    HELD_AT_GOAL_S,
    HELD_S,
    LAST_GOALS_S,
    STILL_S,
    UNKNOWN_S,
)

AWAY_RAD = float(np.radians(0.5))  # distance between goal and measured joint that an arm in servo mode always works off
STILL_RAD = float(np.radians(0.02))  # joints that moved less than this stand still
SAMPLES = 10  # a verdict needs more measurements than this, so that a stall of the loop is not blamed on the arm
BELIEVED_RAD = float(np.radians(0.6))  # measured joints this near to where they can be are believed [rad]


class JointCheck:
    """Compares each reading of the joints, shape (7,) [rad], with the reading before and the goals that the arm had.
    Joints elsewhere than between those, at full `joint_speeds`, shape (7,) [rad/s], are measured wrongly, or something
    else moves the arm: no goal may be made from them. `where`: the least and the greatest joints that the arm can have
    had at the last reading, shape (7,) each [rad]; meaningful once a reading was wrong."""

    where: tuple[np.ndarray, np.ndarray]

    def __init__(self, joint_speeds: np.ndarray) -> None:
        self._speeds = FASTER * joint_speeds
        self._goals: deque[tuple[float, np.ndarray]] = deque(maxlen=1000)  # full where no joints come
        self._last: np.ndarray | None = None

    def stand(self, q: np.ndarray | None) -> None:
        """The arm stands at the joints q from now on; None: it is not known where, nothing is compared with that."""
        self._goals.clear()
        if q is not None:
            self._goals.append((-math.inf, q))

    def follow(self, q: np.ndarray, now: float) -> None:
        """The arm gets the goal q at the monotonic time `now` [s]."""
        self._goals.append((now, q))

    def step(self, measured: np.ndarray, now: float, age: float) -> str | None:
        """Returns None for joints that can be true, else what is wrong, as a part of a sentence. `measured` are the
        newest joints, the same object until newer ones come; those before are at most `age` [s] older."""
        last, self._last = self._last, measured
        goals = self._goals
        while len(goals) > 1 and goals[1][0] <= now - age - LAST_GOALS_S:
            goals.popleft()
        if last is None or measured is last or not goals:
            return None
        moved = np.abs(measured - last)
        if np.all(moved <= STILL_RAD):
            return None
        fast = moved > self._speeds * age + BELIEVED_RAD
        newest = goals[-1][1]
        if not fast.any() and is_within(measured, (np.minimum(newest, last), np.maximum(newest, last))):
            return None  # as nearly always: it would also be within the range of all goals
        known = np.array([last, *(q for _, q in goals)])
        self.where = known.min(axis=0), known.max(axis=0)
        if fast.any():
            k = int(np.argmax(moved - self._speeds * age))
            deg = np.degrees((measured[k], last[k]))
            return f"joint {k + 1} is at {deg[0]:.2f} deg, at most {1e3 * age:.0f} ms after {deg[1]:.2f} deg"
        beyond = _beyond(measured, *self.where)
        k = int(np.argmax(beyond))
        if beyond[k] <= BELIEVED_RAD:
            return None
        deg = np.degrees((measured[k], last[k], newest[k]))
        return f"joint {k + 1} is at {deg[0]:.2f} deg, from {deg[1]:.2f} deg on the way to {deg[2]:.2f} deg"


def is_within(q: np.ndarray, where: tuple[np.ndarray, np.ndarray]) -> bool:
    """Returns whether joints, shape (7,) [rad], are believed of an arm that stands there, see JointCheck."""
    return bool(np.max(_beyond(q, *where)) <= BELIEVED_RAD)


def _beyond(q: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Returns how far each joint is beyond its range, shape (7,) [rad]; negative within it."""
    return np.maximum(low - q, q - high)


class TrackingMonitor:
    """Compares servo goals with measured joints, shape (7,) [rad], cycle by cycle, from the start of servo mode. The
    toolbox does not report that servo mode ended by itself or that a safety stop holds the arm: it still
    acknowledges goals. The measured joints show it: they stand still while the goal moves away, or fall far behind."""

    def __init__(self) -> None:
        self._reference: list[float] | None = None
        self._measured: np.ndarray | None = None
        self._still_since = self._far_since = 0.0
        self._still_samples = self._far_samples = 0
        self._looked = 0.0
        self._unknown = 0.0

    def step(self, goal: np.ndarray, measured: np.ndarray, now: float) -> str | None:
        """Returns None while the arm follows, else what is wrong, as a part of a sentence. `measured` are the newest
        joints, the same object until newer ones come."""
        fresh, self._measured = measured is not self._measured, measured
        cycle = 0.03  # of a longer time between two looks this much counts: no goals were sent meanwhile [s]
        passed, self._looked = min(now - self._looked, cycle), now
        joints = measured.tolist()
        errors = [abs(a - b) for a, b in zip(goal.tolist(), joints)]
        worst = max(errors)
        self._unknown = 0.0 if fresh or worst <= AWAY_RAD else self._unknown + passed
        if self._unknown > UNKNOWN_S:
            return f"no measured joints came for {UNKNOWN_S:g} s while the goals moved on"

        reference = self._reference
        if reference is None or worst <= AWAY_RAD or max([abs(a - b) for a, b in zip(joints, reference)]) > STILL_RAD:
            self._reference = joints
            self._still_since, self._still_samples = now, 0
        self._still_samples += fresh
        if reference is None or worst <= FAR_RAD:
            self._far_since, self._far_samples = now, 0
        self._far_samples += fresh

        if now - self._still_since > STILL_S and self._still_samples > SAMPLES:
            joint = 1 + errors.index(worst)
            return f"the arm stands still although joint {joint} is {np.degrees(worst):.1f} deg away from its goal"
        if now - self._far_since > FAR_S and self._far_samples > SAMPLES:
            return f"joint {1 + errors.index(worst)} is {np.degrees(worst):.1f} deg behind its goal"
        return None


class PtpSupervision:
    """Watches one PTP motion to the joints q, shape (7,) [rad], cycle by cycle; `name` is the goal in words, such as
    "home". The toolbox does not report a safety stop: the joints just come no nearer to the goal. The duration of a
    motion says nothing, because the smartPad's speed override is not known. `held`: whether something holds the arm
    now, `was_held`: since the motion began."""

    def __init__(self, name: str, q: np.ndarray) -> None:
        self.name = name
        self.q = q
        self._ended: float | None = None  # when the motion was over, with the joints not at the goal [s]
        self._readings = 0  # since then
        self._read: np.ndarray | None = None
        self.held = self.was_held = False
        self._approach = PtpApproach(q)

    @property
    def still(self) -> float:
        """Time since the arm came nearer to the goal [s]."""
        return self._approach.still

    def is_at_goal(self, measured: np.ndarray) -> bool:
        """Returns whether the measured joints of an arm whose motion is over, shape (7,) [rad], are at its goal."""
        return bool(np.max(np.abs(measured - self.q)) <= BELIEVED_RAD)

    def ended_elsewhere(self, measured: np.ndarray, now: float) -> str | None:
        """Returns what is wrong if several readings of such an arm are not at the goal, else None."""
        self._ended = now if self._ended is None else self._ended
        self._readings += measured is not self._read
        self._read = measured
        longest = 0.3  # so long after the end of a motion newer joints may show that they are at the goal [s]
        samples = 3  # a verdict needs more readings than this
        if now - self._ended < longest or self._readings <= samples:
            return None
        k = int(np.argmax(np.abs(measured - self.q)))
        deg = np.degrees((measured[k], self.q[k]))
        return f"joint {k + 1} is at {deg[0]:.2f} deg, but its motion to {self.name} has ended, at {deg[1]:.2f} deg"

    def step(self, measured: np.ndarray, now: float) -> Event | None:
        """Returns the event to report when something begins to hold the arm, and when the arm is free again.
        `measured` are the newest joints, shape (7,) [rad], the same object until newer ones come; `now` is
        monotonic."""
        approach = self._approach
        approach.observe(measured, now)
        allowed = HELD_S if approach.begun and approach.remaining > AWAY_RAD else HELD_AT_ENDS_S
        there = math.radians(0.1)  # joints this near to the goal are there
        if approach.remaining <= there:
            allowed = HELD_AT_GOAL_S
        before, self.held = self.held, approach.still > allowed and approach.samples > SAMPLES
        self.was_held |= self.held
        if self.held == before:
            return None
        if self.held:
            return Event(
                "error",
                f"The motion to {self.name} does not continue, {np.degrees(approach.remaining):.1f} deg are left; "
                "if a safety stop holds the arm, free the arm and press run on the smartPad.",
            )
        stays = "stays there until control is switched off and on again"
        return Event("info", f"The arm moves on to {self.name} and {stays}.")

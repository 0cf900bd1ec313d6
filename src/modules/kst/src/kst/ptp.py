"""Supervision of one point-to-point motion: progress, stalls, missed readings, interruption, time-out, arrival.
Pure. The toolbox reports only the end of a motion and cannot stop one. A safety stop or a released enabling switch
therefore shows only in joints that stand still."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

import numpy as np

from kst.limits import read_only

MOVED_RAD = math.radians(0.02)  # a smaller approach to the goal is not a motion [rad]


class PtpApproach:
    """Whether the joints come nearer to the `goal` of a motion, shape (7,) [rad]; its first reading is the start.

    Attributes:
        left: absolute distance of each joint to the goal, shape (7,) [rad].
        still: time since the arm came nearer last [s].
        samples: readings since then; the same array again is no new reading.
        begun: whether the arm has come nearer since the start."""

    def __init__(self, goal: np.ndarray) -> None:
        self._goal = read_only(goal)
        self._last: np.ndarray | None = None
        self._nearest = math.inf
        self._since = 0.0
        self.left = np.full(7, math.inf)
        self.still = 0.0
        self.samples = 0
        self.begun = False

    @property
    def remaining(self) -> float:
        """The largest distance of a joint to the goal [rad]."""
        return float(np.max(self.left))

    def observe(self, q: np.ndarray, now: float) -> None:
        """Takes the measured joints, shape (7,) [rad], at the monotonic time `now` [s]."""
        self.left = np.abs(self._goal - q)
        if self.remaining < self._nearest - MOVED_RAD:
            self.begun = self._last is not None
            self._nearest, self._since, self.samples = self.remaining, now, 0
        self.samples += q is not self._last
        self._last = q
        self.still = now - self._since


@dataclass(frozen=True)
class PtpLimits:
    arrived: float = math.radians(0.1)  # largest distance of a joint from its goal at the end of the motion [rad]
    stalled: float = 3.0  # an arm that stands still for this long is stalled [s]
    given_up: float = 60.0  # an arm that stands still for this long is not awaited any longer [s]
    timeout: float = math.inf  # longest motion [s]
    missed: int = 12  # this many missed readings in a row are an error; a silent server misses one a second, for 10 s
    period: float = 0.1  # time between two readings [s]


class PtpState(enum.Enum):
    """State of a supervised motion; all but MOVING and STALLED are final."""

    MOVING = "moving"
    STALLED = "stalled"
    ARRIVED = "arrived"
    INTERRUPTED = "interrupted"
    SHORT = "ended before its goal"
    GIVEN_UP = "given up"
    TIMED_OUT = "timed out"


@dataclass(frozen=True)
class PtpProgress:
    state: PtpState  # of the motion
    fraction: float  # of the largest joint step that is done, 0 to 1
    joint: int  # the joint with the largest remaining step, 1 to 7
    remaining: float  # that step, absolute [rad]
    still: float  # time since the arm came nearer to its goal [s]
    stall_began: bool = False  # whether the arm is stalled since this reading


@dataclass
class PtpSupervisor:
    """Judges a motion from one reading to the next."""

    start: np.ndarray  # joints before the motion, shape (7,) [rad]
    goal: np.ndarray  # joints after the motion, shape (7,) [rad]
    started: float  # time at which it starts [s]
    limits: PtpLimits = field(default_factory=PtpLimits)  # its bounds

    def __post_init__(self) -> None:
        self._approach = PtpApproach(self.goal)
        self._approach.observe(self.start, self.started)
        self._step = self._approach.remaining
        self._stalled = False
        self._missed = 0

    def observe(self, q: np.ndarray, now: float, arrived: bool = False, interrupted: bool = False) -> PtpProgress:
        """Returns the progress at the measured joints q, shape (7,) [rad], at the monotonic time `now` [s].
        `arrived`: the controller reported the end of the motion before the joints were read. `interrupted`: the user
        wants to wait no longer; the arm continues to its goal."""
        self._missed = 0
        approach = self._approach
        approach.observe(q, now)
        joint, remaining, still = int(np.argmax(approach.left)), approach.remaining, approach.still
        fraction = 1.0 - remaining / self._step if self._step > 0.0 else 1.0
        state = self._state(remaining, still, now, arrived, interrupted)
        stalled = state is PtpState.STALLED
        began, self._stalled = stalled and not self._stalled, stalled
        return PtpProgress(state, min(max(fraction, 0.0), 1.0), joint + 1, remaining, still, began)

    def miss(self) -> bool:
        """Counts a reading that did not come or was unusable; returns whether these are too many in a row."""
        self._missed += 1
        return self._missed >= self.limits.missed

    def _state(self, remaining: float, still: float, now: float, arrived: bool, interrupted: bool) -> PtpState:
        limits = self.limits
        if arrived:
            return PtpState.ARRIVED if remaining <= limits.arrived else PtpState.SHORT
        if interrupted:
            return PtpState.INTERRUPTED
        if still >= limits.given_up:
            return PtpState.GIVEN_UP
        if now - self.started >= limits.timeout:
            return PtpState.TIMED_OUT
        return PtpState.STALLED if still >= limits.stalled else PtpState.MOVING

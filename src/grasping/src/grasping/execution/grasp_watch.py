"""Detects from the hand's state and the tool's height when an operator grasped something, and whether it was held.

The fingers have closed when thumb and a finger are bent and none moves any more; the hand holds something if both still
feel it a moment after the tool is up: a taxel pressed more than when the hand was last open, so that drift has no
effect, or a motor that pulls harder than the finger's springs need.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from common.config import number

TORQUE = "0.1 % of the largest torque"


@dataclass(frozen=True)
class GraspWatchConfig:
    """How a grasp is seen."""

    open_angle: float = number("rad", above=0.0, high=3.0, doc="fingers bent less are open")
    closed_angle: float = number("rad", above=0.0, high=3.0, doc="a thumb and a finger bent more may have closed")
    rest_angle: float = number("rad", above=0.0, high=1.0, doc="fingers that moved less within rest_time are at rest")
    rest_time: float = number("s", above=0.0, high=5.0, doc="how long they have to rest")
    touch_pressure: float = number("counts", above=0.0, high=1000.0, doc="a taxel pressed more is a touch")
    touch_load: float = number(
        TORQUE, above=0.0, high=1000.0, doc="a motor that pulls this much more than the springs need is a touch"
    )
    spring_load: float = number(
        f"{TORQUE} per rad", low=0.0, high=1000.0, doc="what the springs of an empty finger need"
    )
    lift: float = number("m", above=0.0, high=1.0, doc="how high the tool is lifted before it counts")
    hold_time: float = number("s", low=0.0, high=10.0, doc="how long it has to be held then")
    patience: float = number("s", above=0.0, high=600.0, doc="longest time from closing to lifting")

    def faults(self) -> list[str]:
        if self.open_angle > self.closed_angle:
            return [f"open_angle is {self.open_angle:g} and must not be above closed_angle, {self.closed_angle:g}."]
        return []


@dataclass(frozen=True)
class HandMeasurement:
    """The state of index, middle and thumb."""

    angles: np.ndarray  # shape (3,) [rad], 0 = open
    pressures: np.ndarray  # of the taxels, shape (3, 9) [counts]
    loads: np.ndarray  # of their motors, shape (3,), closing positive [0.1 % of the largest torque]


@dataclass(frozen=True, eq=False)
class ObservedGrasp:
    """A grasp and its result."""

    time: float  # when the fingers had closed [s]
    T_base_tool: np.ndarray  # the tool at that time, shape (4, 4) [m]
    held: bool  # whether something was held
    reason: str  # one sentence, how that was seen


class GraspWatch:
    """The watch with its state; `up` is the vertical in the base frame, shape (3,)."""

    def __init__(self, config: GraspWatchConfig, up: np.ndarray) -> None:
        self._config = config
        self._up = np.asarray(up, dtype=float)
        self._untouched = np.zeros((3, 9))
        self.reset()

    def reset(self) -> None:
        """Forgets the past; the hand must be open once before it can close."""
        self._open_seen = False
        self._recent: deque[tuple[float, np.ndarray]] = deque()
        self._closed: tuple[float, np.ndarray] | None = None
        self._lifted: float | None = None

    @property
    def empty(self) -> bool:
        """Whether the hand was open and has not closed since: nothing that it could grasp is in it."""
        return self._open_seen and self._closed is None

    @property
    def closed(self) -> bool:
        """Whether the fingers have closed and the result is still open."""
        return self._closed is not None

    def step(self, hand: HandMeasurement, T_base_tool: np.ndarray, now: float) -> ObservedGrasp | None:
        """Takes a state of the hand, ignored if it is not finite, and returns the grasp whose result it decides, or
        None; `T_base_tool`: the measured tool, shape (4, 4) [m]; `now`: time [s], not falling.
        """
        if not all(np.isfinite(numbers).all() for numbers in (hand.angles, hand.pressures, hand.loads)):
            return None
        if hand.angles.max() < self._config.open_angle:
            self._untouched = hand.pressures
            return self._opened()
        if self._closed is not None:
            return self._judge(*self._closed, hand, T_base_tool, now)
        if self._open_seen and self._at_rest(hand, now) and _opposed(hand.angles > self._config.closed_angle):
            self._closed = (now, np.array(T_base_tool))
        return None

    def give_up(self, reason: str) -> ObservedGrasp | None:
        """Returns the undecided grasp as one that was not held, for a reason (one sentence), or None if not closed."""
        closed = self._closed
        self.reset()
        return None if closed is None else ObservedGrasp(*closed, False, reason)

    def _at_rest(self, hand: HandMeasurement, now: float) -> bool:
        """Takes the angles in and returns whether they rest."""
        self._recent.append((now, hand.angles))
        began = None
        while self._recent and now - self._recent[0][0] >= self._config.rest_time:
            began = self._recent.popleft()
        if began is None:
            return False
        self._recent.appendleft(began)
        angles = np.stack([angles for _, angles in self._recent])
        return bool(np.ptp(angles, axis=0).max() < self._config.rest_angle)

    def _opened(self) -> ObservedGrasp | None:
        closed, lifted = self._closed, self._lifted
        self.reset()
        self._open_seen = True
        if closed is None:
            return None
        how = "before it had been held long enough" if lifted is not None else "before the tool was lifted"
        return ObservedGrasp(*closed, False, f"The fingers opened {how}.")

    def _feels(self, hand: HandMeasurement) -> np.ndarray:
        """Returns whether each finger feels something, shape (3,)."""
        pressed = (hand.pressures - self._untouched).max(axis=1) > self._config.touch_pressure
        return pressed | (hand.loads - self._config.spring_load * hand.angles > self._config.touch_load)

    def _judge(
        self, time: float, T_closed: np.ndarray, hand: HandMeasurement, T_base_tool: np.ndarray, now: float
    ) -> ObservedGrasp | None:
        """Returns the grasp of the closed fingers once it is known whether it held."""
        config = self._config
        height = float(self._up @ (T_base_tool - T_closed)[:3, 3])
        if self._lifted is None and height >= config.lift:
            self._lifted = now
        if self._lifted is None:
            if now - time <= config.patience:
                return None
            held, reason = False, f"The tool was not lifted by {1e3 * config.lift:.0f} mm in {config.patience:g} s."
        elif now - self._lifted < config.hold_time:
            return None
        else:
            held = _opposed(self._feels(hand))
            what = "The thumb and a finger felt something" if held else "Thumb and fingers did not both feel something"
            reason = f"{what} when the tool was {1e3 * height:.0f} mm higher."
        self.reset()
        return ObservedGrasp(time, T_closed, held, reason)


def _opposed(fingers: np.ndarray) -> bool:
    """Returns whether something is true of the thumb and of a finger opposite to it."""
    thumb = 2  # of the fingers index, middle, thumb
    return bool(fingers[thumb] and fingers[:thumb].any())

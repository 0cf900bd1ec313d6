"""What came of a simulated lift, the same for every gripper: did the object that the grasp was meant for rise and stay
up, and if not, why.

The shake after the lift varies gravity, which moves the objects in the hand as accelerations of the hand would.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

GRAVITY = 9.81  # [m/s^2]
SHAKE_G = 0.5  # amplitude
SHAKE_PERIOD_S = 0.3  # one period along each axis of the world, one after the other
SHAKE_S = 3.0 * SHAKE_PERIOD_S
PUSHED_M = 0.005  # an object that moves this far before the fingers close was hit

LIFTED = "lifted"
NO_GRASP = "no grasp"
COLLISION = "finger collision"
MISSED = "missed"
SLIPPED = "slipped"
SHAKEN_OUT = "shaken out"
OTHER_OBJECT = "other object"
DIVERGED = "physics diverged"
FAILURES = (NO_GRASP, COLLISION, MISSED, SLIPPED, SHAKEN_OUT, OTHER_OBJECT, DIVERGED)


class LiftRecord(NamedTuple):
    """What happened to n objects during a lift."""

    reached: bool  # the hand came to its place before it closed
    pushed: np.ndarray  # how far each object moved until then, shape (n,) [m]
    held: np.ndarray  # whether two fingers touched the object when they had closed, shape (n,), bool
    risen: np.ndarray  # rise of each object after the lift, shape (n,) [m]
    kept: np.ndarray  # the same at the end, after the shake if there was one, shape (n,) [m]
    valid: bool = True  # the physics warned of nothing


class LiftResult(NamedTuple):
    """What came of a lift."""

    lifted: bool  # the target rose, and was still up at the end
    rise: float  # of the target [m], 0 where the physics diverged
    reached: bool  # the hand came within 5 mm of the grasp before it closed
    reason: str  # `LIFTED`, or one of `FAILURES`


def outcome(of: LiftRecord, target: int, rise: float) -> str:
    """Returns `LIFTED` if the object `target` is up by more than `rise` [m] at the end, else the failure's reason."""
    if not (of.valid and np.isfinite([*of.risen, *of.kept]).all()):
        return DIVERGED
    if of.kept[target] > rise:
        return LIFTED
    if of.risen[target] > rise:
        return SHAKEN_OUT
    if of.risen.max() > rise:
        return OTHER_OBJECT
    if not of.reached or of.pushed[target] > PUSHED_M:
        return COLLISION
    return SLIPPED if of.held[target] else MISSED


def judged(of: LiftRecord, target: int | None, rise: float) -> LiftResult:
    """Returns the result for a target, None: whichever object is highest at the end; `rise` as in `outcome`."""
    if target is None:
        target = int(np.argmax(of.kept))
    reason = outcome(of, target, rise)
    return LiftResult(reason == LIFTED, 0.0 if reason == DIVERGED else float(of.kept[target]), of.reached, reason)


def shaken_gravity(time: float) -> np.ndarray:
    """Returns gravity `time` [s] after the shake began, shape (3,) [m/s^2]; before and after, it points down."""
    gravity = np.array([0.0, 0.0, -GRAVITY])
    if 0.0 <= time < SHAKE_S:
        gravity[int(time / SHAKE_PERIOD_S)] += SHAKE_G * GRAVITY * np.sin(2.0 * np.pi * time / SHAKE_PERIOD_S)
    return gravity

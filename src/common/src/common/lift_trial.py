"""A simulated lift, the same for every gripper: its phases, whether the object that the grasp was meant for rose and
stayed up, and if not, why. The shake after the lift varies gravity, which moves the objects in the hand as
accelerations of the hand would."""

from __future__ import annotations

from typing import NamedTuple, Protocol, Sequence

import numpy as np

GRAVITY = 9.81  # [m/s^2]
SHAKE_PERIOD_S = 0.3  # one period along each axis of the world, one after the other
SHAKE_S = 3.0 * SHAKE_PERIOD_S

LIFTED = "lifted"
NO_GRASP = "no grasp"
COLLISION = "finger collision"
MISSED = "missed"
SLIPPED = "slipped"
SHAKEN_OUT = "shaken out"
OTHER_OBJECT = "other object"
DIVERGED = "physics diverged"
FAILURES = (NO_GRASP, COLLISION, MISSED, SLIPPED, SHAKEN_OUT, OTHER_OBJECT, DIVERGED)


class LiftPhase(NamedTuple):
    """A part of a trial, in which approach and lift go evenly to their fractions."""

    approach: float  # fraction of the approach at its end
    lift: float  # fraction of the lift at its end
    closing: bool  # whether the fingers close, or keep closed
    shaken: bool = False


PHASES = {
    "approach": LiftPhase(approach=1.0, lift=0.0, closing=False),
    "close": LiftPhase(approach=1.0, lift=0.0, closing=True),
    "lift": LiftPhase(approach=1.0, lift=1.0, closing=True),
    "hold": LiftPhase(approach=1.0, lift=1.0, closing=True),
    "shake": LiftPhase(approach=1.0, lift=1.0, closing=True, shaken=True),
}


class LiftingHand(Protocol):
    """A hand and n objects in the physics."""

    def step(self, approach: float, lift: float, closing: bool, gravity: np.ndarray) -> None:
        """Commands the fractions of approach and lift, and simulates one step; `gravity`: shape (3,) [m/s^2]."""

    def places(self) -> np.ndarray:
        """Returns where the objects are, shape (n, 3) [m]."""

    def missing(self) -> float:
        """Returns how far the hand is from the end of its approach [m]."""

    def held(self) -> np.ndarray:
        """Returns whether two fingers touch each object, shape (n,), bool."""

    def valid(self) -> bool:
        """Returns whether the physics warned of nothing."""


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


def lift(hand: LiftingHand, seconds: Sequence[float], timestep: float, shake: bool) -> LiftRecord:
    """Returns what happens in a trial; `seconds`: of each of the `PHASES`; the last one is left out without a shake."""
    reached_m = 0.005  # a hand that stops this far from its goal met something
    before = hand.places()
    approach = lifted = 0.0
    for (name, phase), duration in zip(PHASES.items(), seconds):
        if phase.shaken and not shake:
            break
        steps = round(duration / timestep)
        for i in range(steps):
            done = (i + 1) / steps
            gravity = shaken_gravity(i * timestep if phase.shaken else SHAKE_S)
            fractions = approach + done * (phase.approach - approach), lifted + done * (phase.lift - lifted)
            hand.step(*fractions, phase.closing, gravity)
        approach, lifted = phase.approach, phase.lift
        if name == "approach":
            reached = abs(hand.missing()) < reached_m
            pushed = np.linalg.norm(hand.places() - before, axis=1)
        elif name == "close":
            held = hand.held()
        elif name == "hold":
            risen = (hand.places() - before)[:, 2]
    kept = (hand.places() - before)[:, 2]
    return LiftRecord(reached, pushed, held, risen, kept, hand.valid())


def outcome(of: LiftRecord, target: int, rise: float) -> str:
    """Returns `LIFTED` if the object `target` is up by more than `rise` [m] at the end, else the failure's reason."""
    pushed_m = 0.005  # an object that moves this far before the fingers close was hit
    if not (of.valid and np.isfinite([*of.risen, *of.kept]).all()):
        return DIVERGED
    if of.kept[target] > rise:
        return LIFTED
    if of.risen[target] > rise:
        return SHAKEN_OUT
    if of.risen.max() > rise:
        return OTHER_OBJECT
    if not of.reached or of.pushed[target] > pushed_m:
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
    shake_g = 0.5  # amplitude
    gravity = np.array([0.0, 0.0, -GRAVITY])
    if 0.0 <= time < SHAKE_S:
        gravity[int(time / SHAKE_PERIOD_S)] += shake_g * GRAVITY * np.sin(2.0 * np.pi * time / SHAKE_PERIOD_S)
    return gravity

"""Leaves out what no hand does: fingers with impossible bones, speeds or order, hands whose palm does not fit the
fingers, turns too fast, or changes its side.

What is left out is missing from the frame, as if not seen. What was plausible last is the measure for `hold` at most;
then a hand is new. A hand whose id changes in its place is the same hand. All is judged in palm axes and by the common
scale of the hand's bones; how far a palm may move is leap_kuka's to say (hand_average.py).

Sources: lengths, Buryanov and Kotiuk, Proportions of Hand Segments, Int. J. Morphol. 28(3), 2010: bones of fingers of
16 to 46 mm in the mean, metacarpals of up to 68 mm. Speeds, Darling, Cole and Abbs, Kinematic variability of grasp
movements, Exp. Brain Res. 73, 1988: the fastest grasps take 0.1 s, so a finger tip goes 4 m/s at most."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from leap_motion.frames import THUMB, LeapFrame, LeapHand
from leap_motion.numbers import SETTLE_S

SHORTEST_M = 0.003  # bone of a finger; a webcam has shown 7 mm
TIP_M = 0.03  # farthest that the finger tip's centre is from the end of the last bone
KNUCKLE_M = 0.12  # farthest that a knuckle is from the palm's centre
NOISE_M, NOISE_RAD = 0.005, math.radians(15.0)  # error of a joint and of the palm's axes, from frame to frame
MOST_BEND_COS = math.cos(math.radians(150.0))  # of a finger's bone against the one before; recorded hands reach 86 deg
MOST_TURN_RAD = math.radians(90.0)  # whatever the time that has passed
SAME_PLACE_M = 0.1  # from the palm of a hand that is gone, at most, is that of a new id the same hand's
NOBODY = np.zeros(5, dtype=bool)
FINGERS = ("thumb", "index finger", "middle finger", "ring finger", "little finger")


def _bound(default: float, unit: str, doc: str, low: float, high: float) -> Any:
    return field(default=default, metadata={"unit": unit, "doc": doc, "low": low, "high": high})


@dataclass(frozen=True)
class HandBounds:
    """What a hand can be and do."""

    longest_bone: float = _bound(
        0.09, "m", "longest bone of a finger, without the palm's; men have 0.055, a webcam has shown 0.04", 0.06, 0.2
    )
    bone_change: float = _bound(
        0.4, "m/s", "how fast a bone may change its length against the hand's others; a webcam's reach it", 0.05, 3.0
    )
    knuckle_shift: float = _bound(
        0.008, "m", "how far a knuckle may move in the palm from frame to frame; a webcam's move 0.003", 0.003, 0.05
    )
    joint_speed: float = _bound(
        4.0, "m/s", "fastest joint of a finger against the palm; the fastest grasps of large hands reach it", 0.5, 20.0
    )
    turn_speed: float = _bound(
        40.0, "rad/s", "fastest turn of the palm; recorded hands reach 20, one that was hardly seen 50", 5.0, 100.0
    )
    hold: float = _bound(
        SETTLE_S,
        "s",
        "for how long what was plausible last is the measure; longer than an engagement outlives its hand",
        0.25,
        2.0,
    )


class _Known:
    """A hand as it was plausible last, its fingers by their types; times [s] on the clock of PlausibleHands."""

    def __init__(self, side: str) -> None:
        self.side = side
        self.at = 0.0
        self.palm = np.zeros(3)  # [m]
        self.axes = np.eye(3)  # of the palm, as columns; x to the little finger's side, shape (3, 3)
        self.joints = np.zeros((5, 5, 3))  # in palm axes from the palm's centre [m]
        self.bones = np.ones((5, 3))  # lengths of the fingers' bones [m]
        self.at_of = np.full(5, -math.inf)  # when each of the fingers was plausible last


class PlausibleHands:
    """Leaves implausible hands and fingers out of frames."""

    def __init__(self, bounds: HandBounds) -> None:
        self._bounds = bounds
        self._known: dict[int, _Known] = {}
        self._time = 0.0
        self._last: tuple[int, float] | None = None  # device time of the newest frame [us], and when it came [s]

    def step(self, frame: LeapFrame, now: float) -> LeapFrame:
        """Returns the frame that came at `now` on a monotonic clock [s] without what no hand does; its `left_out`
        has a sentence each."""
        if self._last is not None:  # a device's clock may stand, and frames may come in bursts
            self._time += max(1e-6 * (frame.timestamp_us - self._last[0]), now - self._last[1], 0.0)
        self._last = frame.timestamp_us, now
        oldest = self._time - self._bounds.hold
        self._known = {number: known for number, known in self._known.items() if known.at >= oldest}
        hands, left_out = [], []
        self._number_anew(frame.hands)
        for hand in frame.hands:
            fault, faults = self._judge(hand)
            if fault:
                left_out.append(f"A {hand.side} hand is left out: {fault}.")
                continue
            left_out += [f"The {FINGERS[finger]} is left out: {why}." for finger, why in faults.items()]
            if faults:
                hand = replace(hand, fingers=tuple(finger for finger in hand.fingers if finger.type not in faults))
            hands.append(hand)
        return replace(frame, hands=tuple(hands), left_out=(*frame.left_out, *left_out)) if left_out else frame

    def _number_anew(self, hands: tuple[LeapHand, ...]) -> None:
        """Gives what is known of a hand that is gone to the nearest one with an unknown id in its place."""
        gone = [number for number in self._known if number not in [hand.id for hand in hands]]
        for number in gone:
            known = self._known[number]
            away = {
                hand.id: float(_norms(hand.palm - known.palm))
                for hand in hands
                if hand.id not in self._known and hand.side == known.side
            }
            if away and min(away.values()) <= SAME_PLACE_M:
                self._known[min(away, key=away.__getitem__)] = self._known.pop(number)

    def _judge(self, hand: LeapHand) -> tuple[str, dict[int, str]]:
        """Returns why the hand is implausible, or an empty text, and why some of its fingers are, by their types."""
        metacarpal = 1.5  # times a finger's bone, in its longest length
        known, bounds = self._known.get(hand.id), self._bounds
        axes = np.empty((3, 3))
        axes[:, 1], axes[:, 2] = -hand.normal, -hand.direction
        axes[:, 0] = _cross(axes[:, 1], axes[:, 2]) if hand.side == "right" else _cross(axes[:, 2], axes[:, 1])
        if known is not None and known.side != hand.side:
            return "it was a hand of the other side", {}
        if known is not None:
            most = min(NOISE_RAD + bounds.turn_speed * (self._time - known.at), MOST_TURN_RAD)
            if float((axes * known.axes).sum()) < 1.0 + 2.0 * math.cos(most):  # the trace of the turn
                return "it turns faster than a hand", {}
        types = [finger.type for finger in hand.fingers]
        if not types:
            self._known[hand.id] = known = known or _Known(hand.side)
            known.palm, known.axes, known.at = hand.palm, axes, self._time
            return "", {}
        of = slice(None) if len(types) == len(FINGERS) else types
        points = np.array([finger.joints for finger in hand.fingers])
        tips = _norms(np.array([finger.tip for finger in hand.fingers]) - points[:, 4])
        joints = (points - hand.palm) @ axes
        steps = joints[:, 1:] - joints[:, :-1]
        lengths = _norms(steps)
        cosines = np.einsum("ijk,ijk->ij", steps[:, 1:], steps[:, :-1])
        folded = (cosines < MOST_BEND_COS * lengths[:, 1:] * lengths[:, :-1]).any(axis=1)
        bones = lengths[:, 1:]
        longest, shortest = np.maximum(bones.max(axis=1), lengths[:, 0] / metacarpal), bones.min(axis=1)
        elsewhere = _norms(joints[:, 1]) > KNUCKLE_M
        sizes = (shortest < SHORTEST_M) | (longest > bounds.longest_bone) | (tips > TIP_M)
        changed = fast = NOBODY[: len(types)]
        if known is not None:
            elapsed = self._time - known.at_of[of]
            fresh = elapsed <= bounds.hold
            ratios = np.sort((bones / known.bones[of])[fresh], axis=None)
            scale = ratios[len(ratios) // 2] if len(ratios) else 1.0
            ways = _norms(joints[:, 1:] - scale * known.joints[of, 1:])
            elsewhere = elsewhere | (ways[:, 0] > bounds.knuckle_shift) & fresh
            changes = np.abs(bones - scale * known.bones[of]).max(axis=1)
            changed = (changes > NOISE_M + bounds.bone_change * elapsed) & fresh
            fast = (ways[:, 1:].max(axis=1) > NOISE_M + bounds.joint_speed * elapsed) & fresh
        faults: dict[int, str] = {}
        wrong = elsewhere | sizes | folded
        misplaced = _misplaced(types, joints[:, 1], ~wrong)
        wrong |= misplaced | changed | fast
        if wrong.any():
            if 2 * np.count_nonzero(elsewhere) > max(len(types), 3):
                return "its palm does not fit its fingers", {}
            lengths_mm = f"{1e3 * SHORTEST_M:g} to {1e3 * bounds.longest_bone:g} mm"
            for why, mask in (
                (f"a bone is not {lengths_mm} long", sizes),
                ("a bone is folded back on the one before", folded),
                ("its knuckle is not where it was in the palm", elsewhere),
                ("its knuckle is in another finger's place", misplaced),
                ("a bone changes its length", changed),
                ("it moves faster than a finger", fast),
            ):
                for i in np.flatnonzero(mask).tolist():
                    faults.setdefault(types[i], why)
            of = [kind for kind in types if kind not in faults]
            joints, bones = joints[~wrong], bones[~wrong]
        self._known[hand.id] = known = known or _Known(hand.side)
        known.palm, known.axes, known.at = hand.palm, axes, self._time
        known.joints[of], known.bones[of], known.at_of[of] = joints, bones, self._time
        return "", faults


def _misplaced(types: list[int], knuckles: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Returns which of the fingers, shape (n,), are not in the order of a hand, by the knuckles of those that are
    `counted`, in palm axes, shape (n, 3): from index to little finger across the palm, the thumb nearest to the wrist.
    """
    wrong = np.zeros(len(types), dtype=bool)
    of, xs, zs = np.flatnonzero(counted).tolist(), knuckles[:, 0].tolist(), knuckles[:, 2].tolist()
    thumb = of.pop(0) if of and types[of[0]] == THUMB else None
    for one, other in zip(of, of[1:]):
        if xs[one] >= xs[other]:
            wrong[[one, other]] = True
    for other in of if thumb is not None else ():
        if zs[other] >= zs[thumb]:
            wrong[[thumb, other]] = True
    return wrong


def _norms(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("...i,...i", vectors, vectors))


def _cross(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Returns a x b; numpy's own function takes ten times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx

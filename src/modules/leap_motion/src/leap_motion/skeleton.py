"""What is drawn of a tracked hand: joints, bones, the palm's axes, and the tracker's confidence as a colour."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from leap_motion.frames import TrackedHand

AXIS_M = 0.06  # length of the palm's two axes


@dataclass(frozen=True)
class Skeleton:
    """A drawn hand, in the Leap frame; without joints where the tracker did not send five whole fingers."""

    bones: np.ndarray  # both ends of each bone, one after the other, shape (40, 3) or (0, 3) [m]
    joints: np.ndarray  # ends of all bones, then the palm, shape (26, 3) or (1, 3) [m]
    normal: np.ndarray  # from the palm along its normal, both ends, shape (2, 3) [m]
    direction: np.ndarray  # from the palm towards the fingers, both ends, shape (2, 3) [m]
    label: str  # side, number and confidence
    label_at: np.ndarray  # shape (3,) [m]
    colour: tuple[float, float, float]  # red, green, blue, 0 to 1


def skeleton(hand: TrackedHand) -> Skeleton | None:
    """Returns what is drawn of a hand; None for one with a position or axis that is not finite."""
    label_above_m = 0.08  # over the highest joint
    fingers = np.empty((0, 5, 3)) if hand.joints is None else hand.joints
    joints = np.vstack((fingers.reshape(-1, 3), hand.palm))
    normal, direction = (np.stack((hand.palm, hand.palm + AXIS_M * axis)) for axis in (hand.normal, hand.direction))
    if not all(np.isfinite(points).all() for points in (joints, normal, direction)):
        return None
    top = joints[joints[:, 1].argmax(), 1]
    return Skeleton(
        bones=np.stack((fingers[:, :-1], fingers[:, 1:]), axis=2).reshape(-1, 3),
        joints=joints,
        normal=normal,
        direction=direction,
        label=f"{hand.name}, confidence {hand.confidence:.2f}",
        label_at=np.array((hand.palm[0], top + label_above_m, hand.palm[2])),
        colour=traffic_light(hand.confidence),
    )


def traffic_light(good: float) -> tuple[float, float, float]:
    """Returns red for 0 or less and for what is no number, yellow for a half, green for 1 or more."""
    good = min(max(good, 0.0), 1.0) if math.isfinite(good) else 0.0
    return min(1.0, 2.0 - 2.0 * good), min(1.0, 2.0 * good) * 0.85, 0.15

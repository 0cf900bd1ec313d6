"""The start gate: a hand that came into the interaction box starts a stream, level, slow and tracked with
confidence. The interaction box is centred on the Leap's y axis, or leap/box_offset beside it; its axes are the
Leap's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from common.errors import ConfigError
from common.poses import read_only
from common.reasons import Reason, ReasonCode
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.hand_average import MeanHand
from leap_kuka.numbers import STILL_SPEED_M_S
from leap_kuka.virtual_leap import attitude, heading

BOX, PITCH, ROLL, STILL, CONFIDENCE = "in the box", "pitch level", "roll level", "slow", "confidence"
CAME_IN, RELEASED, ENABLED, READY, RATE, REACH, CHOSEN = (
    *("came in", "clutch released", "enabled", "arm ready", "tracker fast enough", "within reach", "arm chosen"),
)
CONDITIONS = (BOX, PITCH, ROLL, STILL, CONFIDENCE, CAME_IN, READY, REACH, ENABLED, RELEASED, CHOSEN, RATE)
"""The conditions of a start, as the operator reads them."""
OF_A_HAND = frozenset((BOX, PITCH, ROLL, STILL, CONFIDENCE, CAME_IN, REACH))  # unmet without one

SIDES = (
    (("left of", ReasonCode.LEFT_OF_BOX), ("right of", ReasonCode.RIGHT_OF_BOX)),
    (("below", ReasonCode.BELOW_BOX), ("above", ReasonCode.ABOVE_BOX)),
    (("behind", ReasonCode.BEHIND_BOX), ("in front of", ReasonCode.IN_FRONT_OF_BOX)),
)
"""Position of a palm relative to the box, by axis and sign, as the user sees it: -z points away from the user."""


@dataclass(frozen=True)
class InteractionBox:
    """The box in which a stream starts; its axes are the Leap's."""

    center: np.ndarray  # in the Leap frame, shape (3,) [m]
    size: np.ndarray  # lengths of its edges, shape (3,) [m]

    def outside(self, palm: np.ndarray) -> float:
        """Returns how far a palm, shape (3,) [m], is outside of the box along one of its axes, negative inside [m]."""
        center, size = self.center.tolist(), self.size.tolist()
        distances = [abs(p - c) - s / 2.0 for p, c, s in zip(palm.tolist(), center, size)]
        return math.nan if math.isnan(sum(distances)) else max(distances)


def interaction_box(leap: LeapConfig, arm: ArmPlacement) -> InteractionBox:
    """Returns the box whose centre maps to the centre of the workspace. Raises ConfigError: it would reach into the
    Leap."""
    height = arm.depth + leap.z_clearance
    if height < leap.box_dimensions[1] / 2.0:
        where = f"{leap.box_dimensions[1]:g} m high at {height:g} m"
        raise ConfigError([f"The interaction box, {where}, would reach into the Leap: enlarge leap/z_clearance."])
    return InteractionBox(read_only([leap.box_offset, height, 0.0]), leap.box_dimensions)


def held_still(hand: MeanHand | None) -> bool:
    """Returns whether a hand is held still: so long in view that it has a mean, of one that does not turn too fast
    for that, and for STILL_WINDOW_S slower than STILL_SPEED_M_S."""
    return hand is not None and hand.speed < STILL_SPEED_M_S


class StartGate:
    """The conditions of a start that are the hand's own; a running stream needs only its confidence."""

    def __init__(self, leap: LeapConfig, box: InteractionBox) -> None:
        self._leap = leap
        self._box = box

    def faults(self, hand: MeanHand, obstacles: Mapping[str, Reason], resumes: bool) -> dict[str, Reason]:
        """Returns the conditions that the averaged hand does not meet, with a reason each. `obstacles` are further
        conditions that are not met, the first of them is named. A hand that `resumes` need not be in the box and
        level."""
        faults = {} if resumes else {**self._outside(hand), **self._tilted(hand)}
        faults.update([*obstacles.items()][:1])
        if not held_still(hand):
            too_fast = f"the hand moves too fast for a start, at {hand.speed:.2f} m/s"
            text = f"{too_fast}, and must be below {STILL_SPEED_M_S:g} m/s"
            faults[STILL] = Reason(text, (ReasonCode.TOO_FAST,))
        return {**faults, **self.confidence_fault(hand)}

    def confidence_fault(self, hand: MeanHand) -> dict[str, Reason]:
        """Returns the same of its confidence alone."""
        least = self._leap.min_confidence
        if hand.confidence > least:
            return {}
        text = f"the confidence is {hand.confidence:.2f} and must be above {least:g}"
        return {CONFIDENCE: Reason(text, (ReasonCode.UNSURE,))}

    def _outside(self, hand: MeanHand) -> dict[str, Reason]:
        offset = hand.palm - self._box.center
        parts = [
            (f"{max(1.0, 1e3 * distance):.0f} mm {sides[positive][0]}", sides[positive][1])
            for distance, positive, sides in zip(np.abs(offset) - self._box.size / 2.0, (offset > 0.0).tolist(), SIDES)
            if not distance <= 0.0  # NaN is outside
        ]
        if not parts:
            return {}
        texts, codes = zip(*parts)
        return {BOX: Reason(f"the palm is {' and '.join(texts)} the box", codes)}

    def _tilted(self, hand: MeanHand) -> dict[str, Reason]:
        R_leap_hand = hand.T_leap_hand[:3, :3]
        angles = attitude(R_leap_hand, heading(R_leap_hand[:, 0]))
        limits = {PITCH: ("pitch", self._leap.start_tol_pitch), ROLL: ("roll", self._leap.start_tol_roll)}
        return {
            condition: Reason(
                f"the {name} is {math.degrees(getattr(angles, name)):.1f} deg and must be within {limit:g} deg",
                (ReasonCode.NOT_LEVEL,),
            )
            for condition, (name, limit) in limits.items()
            if abs(getattr(angles, name)) >= math.radians(limit)
        }

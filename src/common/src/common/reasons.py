"""Why an arm follows a hand, or does not: codes for programs, in rig_msgs/TeleopState, and the sentence for people. Arm
and robot hand say the same of the operator's hand in the same words."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from common.hand_tracking import ANY, LEFT, RIGHT

NO_HAND = {ANY: "no hand is seen", LEFT: "no left hand is seen", RIGHT: "no right hand is seen"}
FOLLOWED = "{hand} is followed"
NOT_SEEN = "{hand} is not seen"
IN_VIEW = "{hand} was in view already; take it away and bring it back"


class ReasonCode(str, Enum):
    """What a reason is about."""

    # Of the tracker and the hand.
    TRACKER_SILENT = "tracker_silent"
    TRACKER_SLOW = "tracker_slow"
    NO_HAND = "no_hand"
    NOT_SEEN = "not_seen"  # for a moment; the tool stays
    HAND_GONE = "hand_gone"  # the hand that steered has left the view
    HAND_JUMPED = "hand_jumped"  # or its numbers cannot be right
    FILLING = "filling"  # its mean is not complete yet
    FOLLOWED = "followed"
    # Conditions of a start.
    LEFT_OF_BOX = "left_of_box"
    RIGHT_OF_BOX = "right_of_box"
    BELOW_BOX = "below_box"
    ABOVE_BOX = "above_box"
    BEHIND_BOX = "behind_box"
    IN_FRONT_OF_BOX = "in_front_of_box"
    NOT_LEVEL = "not_level"
    TOO_FAST = "too_fast"
    UNSURE = "unsure"  # the confidence is too low
    IN_BOX_ALREADY = "in_box_already"
    ARM_NOT_READY = "arm_not_ready"
    OUT_OF_REACH = "out_of_reach"
    NOT_ENABLED = "not_enabled"
    CLUTCHED = "clutched"
    ELSEWHERE = "elsewhere"  # another arm is steered
    # What else happens to an engagement.
    CONTROL_ON = "control_on"  # it went on, or was on at the start: the hand must come anew
    CONTROL_OFF = "control_off"
    ARM_LEFT = "arm_left"
    HOLD = "hold"
    EXPIRED = "expired"
    LED = "led"  # by a program
    LEAD_LOST = "lead_lost"


@dataclass(frozen=True)
class Reason:
    """A reason: a sentence without its full stop, and its codes in the sentence's order."""

    text: str
    codes: tuple[ReasonCode, ...] = ()


def joined(whose: str, reasons: Iterable[Reason]) -> Reason:
    """Returns several reasons as one, whose text begins with `whose`."""
    found = list(reasons)
    codes = tuple(code for reason in found for code in reason.codes)
    return Reason(whose + "; ".join(reason.text for reason in found), codes)

"""The states of an engagement, absolute or relative, and the one table of their transitions. teleop.py says what has
happened, a trigger; the table names the next state. Where a state has no row for a trigger, nothing changes.
docs/reference/engagement.md is made from this table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from common import reasons
from common.reasons import Reason, ReasonCode


class Tool(Enum):
    """What the desired tool does."""

    GONE = "is not published; the arm brakes, and goes home after `time_out`"
    STAYS = "stays"
    FOLLOWS = "follows the hand"
    LED = "follows a program"


class EngagementState(Enum):
    """A state: what the tool does, whether a hand owns the engagement, and who may steer next."""

    WAITING = Tool.GONE, False, "a hand that comes in"
    HELD = Tool.STAYS, False, "a hand that comes in; held on request"
    STARTING = Tool.STAYS, True, "the same hand, once the arm servos"
    STEERING = Tool.FOLLOWS, True, "the same hand"
    STAYING = Tool.STAYS, True, "the same hand, once it is seen and the tracker is fast enough"
    PAUSED = Tool.STAYS, True, "the same hand, once it may, anywhere in view, in any orientation"
    KEPT = Tool.STAYS, False, "a hand that comes in, or a program"
    LED = Tool.LED, False, "a hand that comes in"

    def __init__(self, tool: Tool, owned: bool, continues: str) -> None:
        self.tool = tool
        self.owned = owned
        self.continues = continues

    @property
    def running(self) -> bool:
        """Whether a hand steers, or would if nothing kept the tool for a moment."""
        return self in _RUNNING

    @property
    def kept(self) -> bool:
        """Whether the tool stays where an engagement stopped."""
        return self in (EngagementState.PAUSED, EngagementState.KEPT)

    @property
    def held(self) -> bool:
        """Whether the tool is where no hand steers it."""
        return self in (EngagementState.HELD, EngagementState.LED) or self.kept


class EngagementTrigger(Enum):
    """What happens, and how the operator reads it, with the hand's name and a detail."""

    HAND_READY = "a hand meets all conditions", reasons.FOLLOWED, ReasonCode.FOLLOWED
    NOT_SEEN = "the hand is not in the frame", reasons.NOT_SEEN + "; the tool stays", ReasonCode.NOT_SEEN
    SLOW = "fewer than 20 frames per second come", "{detail}", ReasonCode.TRACKER_SLOW
    SEEN = "it is seen, and enough frames come", reasons.FOLLOWED, ReasonCode.FOLLOWED
    ARM_BUSY = (
        "the arm is not in servo mode",
        reasons.FOLLOWED + " once the arm is ready; it is in {detail}",
        ReasonCode.ARM_NOT_READY,
    )
    ARM_READY = "the arm is in servo mode", reasons.FOLLOWED, ReasonCode.FOLLOWED
    STOPPED = "not enabled, clutched, or not chosen", "{detail}", ReasonCode.CLUTCHED
    HAND_LOST = "the hand is lost for 0.2 s, or jumps", "{hand} was lost{detail}", ReasonCode.HAND_GONE
    MOVED = "it moved while the tracker was slow", "{hand} moved while the tracker was slow", ReasonCode.HAND_JUMPED
    UNSURE = "its confidence is too low", "{hand}: {detail}", ReasonCode.UNSURE
    CLUTCH_LOST = "the clutch device is silent", "the clutch device is silent", ReasonCode.CLUTCHED
    TRACKER_LOST = "no frame for 0.2 s, or inconsistent ones", "{detail}", ReasonCode.TRACKER_SILENT
    CONTROL_ON = (
        "control is switched on",
        "control of the arm was switched on; take the hand out of the box and back in",
        ReasonCode.CONTROL_ON,
    )
    CONTROL_FOUND_ON = (
        "control is on when it is first heard of",
        "control of the arm was on at the start; take the hand out of the box and back in",
        ReasonCode.CONTROL_ON,
    )
    CONTROL_OFF = "control is switched off", "control of the arm is off", ReasonCode.CONTROL_OFF
    ARM_LEFT = (
        "the arm no longer follows",
        "the arm does not follow, its controller is in the mode {detail}",
        ReasonCode.ARM_LEFT,
    )
    EXPIRED = "the time is over", "no hand took it over in time", ReasonCode.EXPIRED
    HOLD = "a program holds the tool", "the tool is held", ReasonCode.HOLD
    HOLD_ENDED = "the program ends that", "it was ended", ReasonCode.HOLD
    LEAD = "a program steers", "a program steers the tool", ReasonCode.LED
    LEAD_LOST = "its actions end or are refused", "{detail}", ReasonCode.LEAD_LOST

    def __init__(self, happens: str, sentence: str, code: ReasonCode) -> None:
        self.happens = happens
        self.sentence = sentence
        self.code = code

    def reason(self, hand: str = "", detail: str = "", code: ReasonCode | None = None) -> Reason:
        """Returns what the operator reads; `code`: instead of the trigger's own."""
        return Reason(self.sentence.format(hand=hand, detail=detail), (code or self.code,))


class When(Enum):
    """A guard of a transition."""

    ALWAYS = ""
    RELATIVE = "relative"
    KEEPS = "relative, `hold_time` above 0"
    DROPS = "absolute, or `hold_time` 0"


@dataclass(frozen=True)
class EngagementRow:
    """One row."""

    sources: tuple[EngagementState, ...]
    trigger: EngagementTrigger
    target: EngagementState
    when: When = When.ALWAYS


_S, _T = EngagementState, EngagementTrigger
_RUNNING = (_S.STARTING, _S.STEERING, _S.STAYING)
_OWNED = (*_RUNNING, _S.PAUSED)
_LOSSES = (_T.HAND_LOST, _T.MOVED, _T.UNSURE, _T.CLUTCH_LOST)

TRANSITIONS = (
    EngagementRow((_S.WAITING, _S.HELD, _S.PAUSED, _S.KEPT, _S.LED), _T.HAND_READY, _S.STEERING),
    # The hand steers on, but the tool waits.
    EngagementRow((_S.STEERING, _S.STAYING), _T.ARM_BUSY, _S.STARTING, When.RELATIVE),
    EngagementRow((_S.STARTING,), _T.ARM_READY, _S.STEERING),
    EngagementRow((_S.STEERING,), _T.NOT_SEEN, _S.STAYING),
    EngagementRow((_S.STEERING,), _T.SLOW, _S.STAYING),
    EngagementRow((_S.STAYING,), _T.SEEN, _S.STEERING),
    # Not enabled, clutched, or not chosen.
    EngagementRow(_RUNNING, _T.STOPPED, _S.PAUSED, When.KEEPS),
    EngagementRow(_RUNNING, _T.STOPPED, _S.WAITING, When.DROPS),
    EngagementRow((_S.LED,), _T.STOPPED, _S.KEPT),
    # The hand is gone, or nobody knows what the operator wants.
    *(EngagementRow(_RUNNING, loss, _S.KEPT, When.KEEPS) for loss in _LOSSES),
    *(EngagementRow(_RUNNING, loss, _S.WAITING, When.DROPS) for loss in _LOSSES),
    *(EngagementRow((_S.PAUSED,), loss, _S.KEPT) for loss in _LOSSES),
    # Nobody watches, or the arm is not there for a hand.
    EngagementRow((_S.HELD, _S.KEPT, _S.LED, *_OWNED), _T.TRACKER_LOST, _S.WAITING),
    EngagementRow((_S.KEPT, _S.LED, *_OWNED), _T.CONTROL_ON, _S.WAITING),
    EngagementRow((_S.KEPT, _S.LED, *_OWNED), _T.CONTROL_FOUND_ON, _S.WAITING),
    EngagementRow((_S.HELD, _S.KEPT, _S.LED, _S.PAUSED), _T.CONTROL_OFF, _S.WAITING),
    EngagementRow(_RUNNING, _T.CONTROL_OFF, _S.WAITING, When.RELATIVE),
    EngagementRow((_S.KEPT, _S.LED, *_OWNED), _T.ARM_LEFT, _S.WAITING, When.RELATIVE),
    # Holds.
    EngagementRow((_S.HELD, _S.KEPT, _S.PAUSED), _T.EXPIRED, _S.WAITING),
    EngagementRow((_S.WAITING,), _T.HOLD, _S.HELD),
    EngagementRow((_S.HELD,), _T.HOLD_ENDED, _S.WAITING),
    # Programs, where the tool stays when they end.
    EngagementRow((_S.WAITING, _S.KEPT), _T.LEAD, _S.LED, When.KEEPS),
    EngagementRow((_S.LED,), _T.LEAD_LOST, _S.KEPT),
)
"""All transitions. No end of an engagement is a motion: the tool stays, or is no longer published."""


def next_state(state: EngagementState, trigger: EngagementTrigger, relative: bool, keeps: bool) -> EngagementState:
    """Returns the state after a trigger; `keeps`: whether the tool stays for the next hand."""
    valid = {When.ALWAYS, When.KEEPS if keeps else When.DROPS, *([When.RELATIVE] if relative else [])}
    for row in TRANSITIONS:
        if state in row.sources and row.trigger is trigger and row.when in valid:
            return row.target
    return state

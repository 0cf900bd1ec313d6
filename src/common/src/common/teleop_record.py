"""The state of an arm's teleoperation as other nodes need it, from a message of rig_msgs/TeleopState."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from common.hand_tracking import LEFT
from common.reasons import ReasonCode

WAITING = "waiting"
RUNNING = "running"
CLUTCHED = "clutched"
HELD = "held"
TAKEN = "taken"
LED = "led"
NO_HOLD = "none"


@dataclass(frozen=True)
class TeleopRecord:
    """What leap_kuka/state says; a code that a newer version of leap_kuka has added is left out."""

    state: str  # waiting, running, holding or clutched
    reason: str  # one sentence
    follows: bool = False  # whether the tool follows the hand
    owner: tuple[int, bool] | None = None  # id of the hand that steers, and whether it is a left one
    hold: str = NO_HOLD
    keep_grip: bool = False  # whether the robot hand keeps its grip while it does not see the hand that steers
    clutched: bool = False
    conditions: tuple[str, ...] = ()  # of a start, in their order
    fulfilled: tuple[bool, ...] = ()  # whether each is
    limits: tuple[str, ...] = ()  # angles of the hand that are at their limit
    codes: tuple[ReasonCode, ...] = ()  # of the reason

    @property
    def running(self) -> bool:
        """Whether a hand steers, or would if nothing kept the tool for a moment."""
        return self.state == RUNNING

    @property
    def met(self) -> frozenset[str]:
        return frozenset(name for name, met in zip(self.conditions, self.fulfilled) if met)


def teleop_record(message: Any) -> TeleopRecord:
    known = {code.value for code in ReasonCode}
    return TeleopRecord(
        message.state,
        message.reason,
        message.follows,
        (message.hand_id, message.hand_side == LEFT) if message.hand_side else None,
        message.hold,
        message.keep_grip,
        message.clutched,
        tuple(message.conditions),
        tuple(message.fulfilled),
        tuple(message.limits),
        tuple(ReasonCode(code) for code in message.reason_codes if code in known),
    )

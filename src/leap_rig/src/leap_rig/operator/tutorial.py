"""Leads a visitor through the first minutes at the rig: a step is ticked when it was really done. The tutorial is fed
with records of what the rig publishes, and asked for its view about ten times a second. Steps come in a fixed order and
never go back. A step counts only what happens in it, and only fresh records: while something is silent, nothing is
ticked. Texts are keys of tutorial_texts.py."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Union

import numpy as np

from common.limits import Limit
from common.modes import Mode
from common.operator_rows import OLD_ROWS_S
from common.reasons import ReasonCode
from common.rotations import rotation_angle
from common.teleop_record import RUNNING, WAITING, TeleopRecord
from leap_kuka.start_gate import BOX, PITCH, ROLL

HINT_S = 4.0  # a step that takes longer gets a hint
TURN_RAD = math.radians(7.0)  # of the flange from its orientation when the step began
FLAT = {BOX, PITCH, ROLL}
GONE = {ReasonCode.NO_HAND, ReasonCode.HAND_GONE}  # the hand has left the view
HINTS = {
    ReasonCode.ABOVE_BOX: "too_high",
    ReasonCode.BELOW_BOX: "too_low",
    ReasonCode.LEFT_OF_BOX: "too_left",
    ReasonCode.RIGHT_OF_BOX: "too_right",
    ReasonCode.BEHIND_BOX: "too_far",
    ReasonCode.IN_FRONT_OF_BOX: "too_near",
    ReasonCode.NOT_LEVEL: "not_level",
    ReasonCode.TOO_FAST: "too_fast",
    ReasonCode.UNSURE: "unsure",
    ReasonCode.HAND_JUMPED: "unsure",
    ReasonCode.IN_BOX_ALREADY: "come_again",
    ReasonCode.CONTROL_ON: "come_again",
    ReasonCode.TRACKER_SILENT: "no_leap",
    ReasonCode.NO_HAND: "no_hand",
    ReasonCode.NOT_SEEN: "no_hand",
    ReasonCode.HAND_GONE: "no_hand",
}
"""The hint for a reason; a reason without one leaves that of the step."""


@dataclass(frozen=True)
class ArmRecord:
    """Of kuka/status."""

    mode: str
    control_on: bool
    gripper_on: bool
    limited_by: tuple[Limit, ...] = ()


@dataclass(frozen=True)
class FlangeRecord:
    """Where the flange was measured."""

    T_base_flange: np.ndarray  # shape (4, 4) [m]


@dataclass(frozen=True)
class FingersRecord:
    """How far the robot hand is closed."""

    closed: float  # 0 to 1


Record = Union[TeleopRecord, ArmRecord, FlangeRecord, FingersRecord]
FRESH_S = {TeleopRecord: OLD_ROWS_S, ArmRecord: 1.0, FlangeRecord: 0.5, FingersRecord: 0.5}
STEPS = ("flat", "green", "move", "fingers", "tilt", "clutch", "away")
DONE = "done"


@dataclass(frozen=True)
class TutorialView:
    """What the visitor sees."""

    steps: tuple[str, ...]  # all of them, in their order
    ticked: int  # how many are done
    step: str  # the present one, or DONE
    progress: float  # of it, 0 to 1
    hint: str  # key of a hint, or empty


class Tutorial:
    """The tutorial with its state. The step "clutch" is only there with a `clutch`."""

    def __init__(self, clutch: bool = False) -> None:
        self._records: dict[type, tuple[Record, float]] = {}
        self._ticked: list[str] = []
        self._steps: dict[str, Callable[[float], float]] = {
            name: getattr(self, f"_{name}") for name in STEPS if clutch or name != "clutch"
        }
        self._began: float | None = None  # the present step
        self._viewed = -math.inf
        self._since: float | None = None  # since when what must last lasts
        self._start: np.ndarray | None = None  # flange at the beginning of the motion
        self._before = False  # whether fingers were open, or the clutch pressed, in this step

    def take(self, record: Record, now: float) -> None:
        """Takes a record that arrived `now` [s]; one with invalid numbers is ignored."""
        if isinstance(record, FlangeRecord) and not np.isfinite(record.T_base_flange).all():
            return
        if isinstance(record, FingersRecord) and not math.isfinite(record.closed):
            return
        self._records[type(record)] = (record, now)

    def view(self, now: float) -> TutorialView:
        """Ticks the present step if it is done `now` [s], and returns what the visitor sees."""
        largest_pause_s = 0.5  # between two views; after a longer one a time that must pass begins anew
        if self._began is None:
            self._began = now
        if now - self._viewed > largest_pause_s:
            self._since = None
        self._viewed = now
        names = tuple(self._steps)
        step = names[len(self._ticked)] if len(self._ticked) < len(names) else DONE
        progress = 1.0 if step == DONE else self._steps[step](now)
        if step != DONE and progress >= 1.0:
            self._ticked.append(step)
            self._began, self._since, self._start, self._before = now, None, None, False
            return self.view(now)
        hint = "" if step == DONE or now - self._began < HINT_S else self._hint(step, now)
        return TutorialView(names, len(self._ticked), step, progress, hint)

    def _fresh(self, kind: type, now: float) -> Any:
        """Returns the newest record of a kind, or None if it is old."""
        record, came = self._records.get(kind, (None, -math.inf))
        return record if now - came <= FRESH_S[kind] else None

    def _lasts(self, condition: bool, seconds: float, now: float) -> float:
        if not condition:
            self._since = None
            return 0.0
        if self._since is None:
            self._since = now
        return min(1.0, (now - self._since) / seconds)

    def _follows(self, now: float) -> bool:
        teleop, arm = self._fresh(TeleopRecord, now), self._fresh(ArmRecord, now)
        return teleop is not None and arm is not None and teleop.follows and arm.mode == Mode.SERVO

    def _flat(self, now: float) -> float:
        flat_s = 0.3  # how long the hand must be flat
        teleop = self._fresh(TeleopRecord, now)  # a hand that continues where the tool is held need not be level
        flat = teleop is not None and teleop.state in (WAITING, RUNNING) and teleop.met >= FLAT
        return self._lasts(flat, flat_s, now)

    def _green(self, now: float) -> float:
        follows_s = 0.5  # how long the arm must follow
        return self._lasts(self._follows(now), follows_s, now)

    def _motion(self, now: float) -> tuple[float, float]:
        """Returns how far the flange has moved [m] and turned [rad] in this step, while the arm followed the hand."""
        flange = self._fresh(FlangeRecord, now)
        if flange is None or not self._follows(now):
            self._start = None
            return 0.0, 0.0
        T = flange.T_base_flange
        if self._start is None:
            self._start = T
        return float(np.linalg.norm(T[:3, 3] - self._start[:3, 3])), rotation_angle(self._start[:3, :3].T @ T[:3, :3])

    def _move(self, now: float) -> float:
        distance_m = 0.06  # of the flange from where the step began
        return min(1.0, self._motion(now)[0] / distance_m)

    def _tilt(self, now: float) -> float:
        return min(1.0, self._motion(now)[1] / TURN_RAD)

    def _fingers(self, now: float) -> float:
        opened = 0.3  # fractions of a closed robot hand
        closed = 0.6
        fingers = self._fresh(FingersRecord, now)
        if fingers is None or not self._follows(now):
            self._before = False
            return 0.0
        self._before |= fingers.closed < opened
        return min(1.0, max(0.0, fingers.closed) / closed) if self._before else 0.0

    def _clutch(self, now: float) -> float:
        teleop = self._fresh(TeleopRecord, now)
        if teleop is None:
            self._before = False
            return 0.0
        self._before |= teleop.clutched
        return 0.0 if not self._before else 0.5 if teleop.clutched or not self._follows(now) else 1.0

    def _away(self, now: float) -> float:
        away_s = 0.5  # how long the hand must be away
        teleop, arm = self._fresh(TeleopRecord, now), self._fresh(ArmRecord, now)
        home = teleop is not None and teleop.state == WAITING and arm is not None and arm.mode != Mode.SERVO
        return self._lasts(home and _gone(teleop), away_s, now)

    def _hint(self, step: str, now: float) -> str:
        """Returns what hinders the visitor, or how the step is done."""
        teleop, arm = self._fresh(TeleopRecord, now), self._fresh(ArmRecord, now)
        if teleop is None:
            return "no_leap"
        if arm is None:
            return "no_arm"
        if step == "away":
            return "held" if _gone(teleop) and teleop.state != WAITING else step
        if not arm.control_on:
            return "control_off"
        if not teleop.follows:
            return next((HINTS[code] for code in teleop.codes if code in HINTS), step)
        if step == "fingers" and not arm.gripper_on:
            return "gripper_off"
        if step == "fingers" and self._fresh(FingersRecord, now) is None:
            return "no_robot_hand"
        if any(limit.speed for limit in arm.limited_by):
            return "slower"
        if any(limit.edge for limit in arm.limited_by):
            return "edge"
        return step


def _gone(teleop: TeleopRecord) -> bool:
    return not GONE.isdisjoint(teleop.codes)

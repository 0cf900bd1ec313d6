"""Whether an episode did what it should, as the simulated world or the taxels know it.

held                 two fingers touch something at the end
lifted               an object is in the hand, 50 mm above the table, at the end
placed:X,Y,WITHIN    an object was lifted, and lies at rest, let go, within WITHIN of X, Y in the base frame [m]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from common.episode_marks import FAILURE, SUCCESS
from leap_rig.recording.session import EpisodeFault

HELD, LIFTED, PLACED = "held", "lifted", "placed"
LIFTED_M = 0.05
FINGERS = 2  # that must touch
REST_M_S = 0.02


@dataclass(frozen=True)
class SeenObject:
    """An object of the simulated world."""

    name: str
    x: float  # in the base frame [m]
    y: float
    clearance: float  # of its lowest point above the table [m]
    speed: float  # [m/s]
    touched: bool  # by the hand


@dataclass(frozen=True)
class SuccessRule:
    """What is asked of an episode; `name` empty: nothing."""

    name: str = ""
    x: float = 0.0
    y: float = 0.0
    within: float = 0.0

    @classmethod
    def parse(cls, text: str) -> SuccessRule:
        """Returns the rule of a text as above; raises EpisodeFault for another one."""
        name, _, rest = text.partition(":")
        try:
            values = [float(part) for part in rest.split(",")] if rest else []
        except ValueError:
            values = [math.nan]
        placed = name == PLACED and len(values) == 3 and all(map(math.isfinite, values)) and values[2] > 0.0
        if placed or (name in ("", HELD, LIFTED) and not rest):
            return cls(name, *values)
        allowed = "must be held, lifted, or placed:X,Y,WITHIN in m with WITHIN above 0"
        raise EpisodeFault(f"The rule of success is {text!r}, but {allowed}.")


class SuccessJudge:
    """Follows one episode; `thing`: the only object that counts, empty: any."""

    def __init__(self, rule: SuccessRule, thing: str = "") -> None:
        self._rule, self._thing = rule, thing
        self._objects: tuple[SeenObject, ...] | None = None
        self._lifted: set[str] = set()
        self._fingers: int | None = None

    def objects(self, seen: Sequence[SeenObject]) -> None:
        """Takes the objects of the world as they are now."""
        self._objects = tuple(one for one in seen if self._thing in ("", one.name))
        self._lifted |= {one.name for one in self._objects if one.touched and one.clearance >= LIFTED_M}

    def fingers(self, touching: int) -> None:
        """Takes how many fingers touch something now."""
        self._fingers = touching

    def verdict(self) -> tuple[str, str]:
        """Returns `success`, `failure`, or nothing where that is not known, and why, a clause."""
        rule = self._rule
        if not rule.name:
            return "", ""
        if rule.name == HELD:
            if self._fingers is None:
                return "", "the hand sent nothing"
            return _said(self._fingers >= FINGERS), f"{self._fingers} fingers touch something at the end"
        if self._objects is None:
            return "", "nothing says where the objects are"
        if rule.name == LIFTED:
            up = [one.name for one in self._objects if one.touched and one.clearance >= LIFTED_M]
            return _said(bool(up)), f"{', '.join(up) or 'nothing'} is in the hand above the table at the end"
        placed = [one.name for one in self._objects if one.name in self._lifted and self._lies(one)]
        return _said(bool(placed)), f"{', '.join(placed) or 'nothing'} was lifted and lies at its place at the end"

    def _lies(self, one: SeenObject) -> bool:
        off = math.hypot(one.x - self._rule.x, one.y - self._rule.y)
        return off <= self._rule.within and not one.touched and one.speed <= REST_M_S and one.clearance < LIFTED_M


def _said(good: bool) -> str:
    return SUCCESS if good else FAILURE

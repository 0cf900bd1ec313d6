"""The words of the robot application's wire, and what is wrong with a line. Source: Word.java, Request.java and
Limits.java of sunrise_application, whose sentences these are."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np

from rig_simulation.devices.sunrise import java_text

READER, GOAL, MAIN, EXACT, OLD, OURS, AT_REST = "reader", "goal", "main", "exact", "old", "ours", "at rest"
"""Who answers a word: the reader, at any time; the main thread, at rest; EXACT: is compared wholly; OLD: the robot
application alone, and to clients alone that do not say hello."""
FEEDBACK = ("ExT", "MT", "JP", "EEfP")
MOST_NUMBERS, LONGEST_NUMBER = 32, 64
RANGES_RAD = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
MOST_KG, MOST_CENTRE_MM, MOST_TOOL_MM = 14.0, 500.0, 1000.0


@dataclasses.dataclass(frozen=True)
class Word:
    """A word, and how many numbers follow it."""

    text: str
    kind: str
    least: int = 0
    most: int = 0

    @property
    def ours(self) -> bool:
        return self.kind in (OURS, AT_REST)

    def begins(self, line: str) -> bool:
        """Returns whether the line is this word: ours by the whole first field, the toolbox's by its beginning."""
        if self.kind == EXACT:
            return line == self.text
        return line.startswith(self.text) and (not self.ours or line[len(self.text) :][:1] in ("", "_"))


WORDS = (
    Word("end", READER),
    *(Word(f"jp{suffix}_", GOAL, 7, 7) for suffix in (*FEEDBACK, "EEfFrelEEF", "")),
    Word("jf_", GOAL, 7, 7),
    *(Word(f"DcSeCar{suffix}_", OLD) for suffix in (*FEEDBACK, "EEfFrelEEF", "")),
    *(Word(f"velJDC{suffix}_", OLD) for suffix in (*FEEDBACK, "")),
    *(Word(f"cArtixanPosition{suffix}_", OLD) for suffix in ("Circ1", "Circ2", "")),
    Word("stopDirectServoJoints", READER),
    Word("getJointsPositions", READER),
    *(Word(f"getPin{n}", READER) for n in (3, 4, 10, 13, 16)),
    *(Word(f"blue{state}", READER) for state in ("On", "Off")),
    *(Word(f"pin{n}{state}", READER) for n in (1, 2, 11, 12) for state in ("on", "off")),
    Word("TFtrans", MAIN, 6, 6),
    Word("jRelVel_", MAIN, 1, 1),
    Word("doPTPinJS", MAIN),
    Word("doPTP!inJS", MAIN, 0, 21),
    *(Word(f"doPTPinCS{suffix}", OLD) for suffix in ("RelBase", "RelEEF", "Circle1", "")),
    *(Word(f"doPTP!{suffix}", OLD) for suffix in ("inCS", "CSCircle1")),
    Word("startDirectServoJoints", MAIN),
    *(Word(text, OLD) for text in ("stDcEEf_", "stVelDcJoint_", "startSmartImpedneceJoints", "handGuiding")),
    *(Word(f"preciseHandGuiding{n}", OLD) for n in (1, 2)),
    *(Word(f"Torques_{what}_J", MAIN) for what in ("ext", "m")),
    *(Word(f"Eef_{what}", EXACT) for what in ("pos", "force", "moment")),
    *(Word(f"lr{name}", OURS, 1, 1) for name in ("Hello", "Channel")),
    *(Word(f"lr{name}", OURS) for name in ("Beat", "State", "Stop", "Pause", "Resume", "Cancel")),
    Word("jpState", OURS, 7, 7),
    Word("lrWatchdog", OURS, 2, 2),
    Word("lrContact", OURS, 8, 8),
    Word("lrTool", AT_REST, 10, 10),
    Word("lrLoad", AT_REST, 4, 4),
    Word("lrSoftJoints", AT_REST, 8, 8),
    Word("lrSoftTool", AT_REST, 12, 12),
    *(Word(f"lr{name}", AT_REST) for name in ("Stiff", "Float", "Guide")),
)


@dataclasses.dataclass(frozen=True)
class Request:
    """A line, read: its word, None if it is none; its numbers; what is no number in it, or None."""

    line: str
    word: Word | None
    numbers: tuple[float, ...] = ()
    fault: str | None = None

    @property
    def name(self) -> str:
        """The word in answers that refuse it."""
        return "word" if self.word is None else self.word.text.rstrip("_")

    @property
    def refusal(self) -> str | None:
        """Why a client that said hello is refused; None if the line is well-formed."""
        assert self.word is not None  # what is no word has its own answer
        if self.word.kind == OLD:
            return "not offered to a client that says hello"
        least, most, count = self.word.least, self.word.most, len(self.numbers)
        if self.fault is not None:
            return self.fault
        if not least <= count <= most:
            return f"{count} numbers came, {'' if least == most else f'{least} to '}{most} are needed"
        return None if all(map(math.isfinite, self.numbers)) else "a number is not finite"


def read(line: str) -> Request:
    """Returns a line without its end as a request; numbers behind a word that has none are not read."""
    word = next((word for word in WORDS if word.begins(line)), None)
    if word is None or word.most == 0:
        return Request(line, word)
    numbers: list[float] = []
    for field in line.split("_")[1:]:
        if not field:
            continue
        if len(numbers) == MOST_NUMBERS:
            return Request(line, word, tuple(numbers), f"more than {MOST_NUMBERS} numbers")
        try:
            if len(field) > LONGEST_NUMBER:
                raise ValueError
            numbers.append(java_text.number(field))
        except ValueError:
            return Request(line, word, tuple(numbers), f"field {len(numbers) + 1} is not a number")
    return Request(line, word, tuple(numbers))


def outside(joints: Iterable[float]) -> int | None:
    """Returns the first joint, counted from 0, whose angle [rad] is outside its range or not a number."""
    return next((k for k, angle in enumerate(joints) if not abs(angle) <= RANGES_RAD[k]), None)


def out_of_range(what: str, values: Sequence[float], low: float, high: float) -> str | None:
    """Returns why the values are refused, or None."""
    for value in values:
        if not low <= value <= high:
            return f"{what} is {java_text.text(value)}, but must be {java_text.text(low)} to {java_text.text(high)}"
    return None


def refused_tool(n: Sequence[float]) -> str | None:
    """Returns why the numbers of lrTool or lrLoad are refused, or None."""
    return (
        out_of_range("the mass", n[:1], 0.0, MOST_KG)
        or out_of_range("the centre of mass in mm", n[1:4], -MOST_CENTRE_MM, MOST_CENTRE_MM)
        or out_of_range("the tool point in mm", n[4:7], -MOST_TOOL_MM, MOST_TOOL_MM)
        or out_of_range("an angle", n[7:10], -2.0 * math.pi, 2.0 * math.pi)
    )


def refused_contact(n: Sequence[float]) -> str | None:
    """Returns why the numbers of lrContact are refused, or None."""
    return out_of_range("a torque", n[:7], 0.0, 320.0) or out_of_range("the force", n[7:], 0.0, 500.0)


def refused_softness(n: Sequence[float]) -> str | None:
    """Returns why the numbers of lrSoftJoints or lrSoftTool are refused, or None; ranges: KUKA's control modes."""
    if len(n) == 8:
        return out_of_range("a joint's stiffness", n[:7], 0.0, 5000.0) or out_of_range("the damping", n[7:], 0.1, 1.0)
    return (
        out_of_range("a stiffness along an axis", n[:3], 0.0, 5000.0)
        or out_of_range("a stiffness about an axis", n[3:6], 0.0, 300.0)
        or out_of_range("the damping", n[6:7], 0.1, 1.0)
        or out_of_range("the null space's stiffness", n[7:8], 0.0, 1000.0)
        or out_of_range("the force", n[8:9], 1.0, 200.0)
        or out_of_range("the moment", n[9:10], 0.1, 50.0)
        or out_of_range("the path's deviation in mm", n[10:11], 1.0, 500.0)
        or out_of_range("the path's deviation in rad", n[11:], 0.01, 2.0)
    )


def ok(name: str, values: Sequence[float] = ()) -> str:
    return f"ok_{name}_{java_text.vector(values)}\n"


def no(name: str, why: str) -> str:
    return f"no_{name}_{plain(why)}_\n"


def stopped(why: str) -> str:
    return f"stopped_{plain(why)}_\n"


def event(what: str) -> str:
    return f"event_{plain(what)}_\n"


def plain(text: str) -> str:
    """Returns the text as one field: without `_`, and printable ASCII alone."""
    longest = 200
    return "".join(" " if c == "_" or not " " <= c <= "~" else c for c in text[:longest])

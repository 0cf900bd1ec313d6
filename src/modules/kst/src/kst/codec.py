"""Wire text of the KUKA Sunrise Toolbox: commands to lines, bytes to replies. Pure; knows no socket and no time.

Millimetres and the angles A, B, C of the wire end here: poses are 4x4 matrices in metres on this side. The commands
and their threads follow reference kst.md, 2; those that no server understands, or that hurt it, are left out.
"""

from __future__ import annotations

import enum
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from common.poses import check_pose, pose, read_only
from common.rotations import rotation_from_zyx, zyx_from_rotation

MAX_LINE = 512
"""Longest reply taken for one, in bytes; seven doubles in Java's longest text need about 180."""

MAX_TOOL_M = 1.0
"""A tool tip farther from the flange is taken for a mix-up of millimetres and metres."""

OUTPUT_PINS = (1, 2, 11, 12)
INPUT_PINS = (3, 4, 10, 13, 16)

_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|Infinity)|NaN")


class Thread(enum.Enum):
    """Which of the server's two threads answers a command (reference: kst.md, 0)."""

    READER = "reader"
    MAIN = "main"


class Kind(enum.Enum):
    """What a reply is, or which reply a command asks for."""

    NOTHING = "no answer"
    DONE = "done"
    NAK = "nak"
    PIN = "0 or 1"
    THREE = "3 numbers"
    SIX = "6 numbers"
    SEVEN = "7 numbers"
    FOREIGN = "no reply of the toolbox"


_KIND_OF_COUNT = {3: Kind.THREE, 6: Kind.SIX, 7: Kind.SEVEN}
_KIND_OF_WORD = {"done": Kind.DONE, "nak": Kind.NAK}


@dataclass(frozen=True)
class Command:
    """One line to the server, without its line feed, who answers it and how."""

    line: str
    thread: Thread
    answer: Kind

    @property
    def word(self) -> str:
        """The command without its numbers, for messages."""
        return self.line.split("_", 1)[0] if self.line.endswith("_") else self.line


@dataclass(frozen=True)
class Reply:
    """One line from the server; `text` is made printable, `numbers` hold what it says in wire units."""

    text: str
    kind: Kind
    numbers: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class ToolTransform:
    """Pose of the tool point at the flange, T_flange_tool, shape (4, 4) [m].

    Raises:
        ValueError: not a rigid pose, or farther than `MAX_TOOL_M` from the flange.
    """

    T_flange_tool: np.ndarray

    def __post_init__(self) -> None:
        T = read_only(check_pose(self.T_flange_tool))
        object.__setattr__(self, "T_flange_tool", T)
        if np.linalg.norm(T[:3, 3]) > MAX_TOOL_M:
            raise ValueError(f"the tool point {T[:3, 3].tolist()} m is too far from the flange; are these millimetres?")


class Feedback(enum.Enum):
    """What the server sends back on a joint servo goal: the command's prefix and the kind of the answer."""

    DONE = ("jp", Kind.DONE)
    NOTHING = ("jf", Kind.NOTHING)
    JOINTS = ("jpJP", Kind.SEVEN)
    EXTERNAL_TORQUES = ("jpExT", Kind.SEVEN)
    MEASURED_TORQUES = ("jpMT", Kind.SEVEN)
    POSE = ("jpEEfP", Kind.SIX)
    FORCE = ("jpEEfFrelEEF", Kind.THREE)


JOINTS = Command("getJointsPositions", Thread.READER, Kind.SEVEN)
EXTERNAL_TORQUES = Command("Torques_ext_J", Thread.MAIN, Kind.SEVEN)
MEASURED_TORQUES = Command("Torques_m_J", Thread.MAIN, Kind.SEVEN)
POSE = Command("Eef_pos", Thread.MAIN, Kind.SIX)
FORCE = Command("Eef_force", Thread.MAIN, Kind.THREE)
MOMENT = Command("Eef_moment", Thread.MAIN, Kind.THREE)
START_PTP = Command("doPTPinJS", Thread.MAIN, Kind.DONE)
START_SERVO = Command("startDirectServoJoints", Thread.MAIN, Kind.DONE)
STOP_SERVO = Command("stopDirectServoJoints", Thread.READER, Kind.DONE)
END = Command("end", Thread.READER, Kind.NOTHING)


def attach_tool(tool: ToolTransform) -> Command:
    """Returns the command that makes `tool` the one whose pose, force and moment the server reports."""
    return Command(_with_numbers("TFtrans", fields_from_pose(tool.T_flange_tool)), Thread.MAIN, Kind.DONE)


def relative_velocity(velocity: float) -> Command:
    """Returns the command that sets the speed of the next PTP, 0 to 1 of the greatest."""
    return Command(_with_numbers("jRelVel", (velocity,)), Thread.MAIN, Kind.DONE)


def joint_goal(q: Iterable[float], feedback: Feedback = Feedback.DONE) -> Command:
    """Returns the command that sets the goal of the joint servo or of the next PTP to q, shape (7,) [rad]."""
    prefix, answer = feedback.value
    return Command(_with_numbers(prefix, q), Thread.READER, answer)


def blue(on: bool) -> Command:
    """Returns the command for the blue light of the media flange."""
    return Command("blueOn" if on else "blueOff", Thread.READER, Kind.DONE)


def set_pin(number: int, on: bool) -> Command:
    """Returns the command for an output of connector X3.

    Raises:
        ValueError: there is no such output; the server would not answer.
    """
    if number not in OUTPUT_PINS:
        raise ValueError(f"there is no output pin {number!r}; the outputs are {OUTPUT_PINS}")
    return Command(f"pin{number}{'on' if on else 'off'}", Thread.READER, Kind.DONE)


def get_pin(number: int) -> Command:
    """Returns the command that reads an input of connector X3.

    Raises:
        ValueError: there is no such input; the server would not answer.
    """
    if number not in INPUT_PINS:
        raise ValueError(f"there is no input pin {number!r}; the inputs are {INPUT_PINS}")
    return Command(f"getPin{number}", Thread.READER, Kind.PIN)


def fields_from_pose(T: np.ndarray) -> tuple[float, ...]:
    """Returns x, y, z [mm], A about Z, B about Y, C about X [rad] of the pose T, shape (4, 4) [m]."""
    return (*(1000.0 * T[:3, 3]), *zyx_from_rotation(T[:3, :3]))


def pose_from_fields(fields: Iterable[float]) -> np.ndarray:
    """Returns the pose, shape (4, 4) [m], of x, y, z [mm], A, B, C [rad]."""
    x, y, z, a, b, c = fields
    return pose(rotation_from_zyx(a, b, c), (x / 1000.0, y / 1000.0, z / 1000.0))


def number(value: float) -> str:
    """Returns the shortest text that Java reads back as the same double.

    Raises:
        ValueError: not finite; such a word kills the server's reader thread.
    """
    value = float(value)
    if not math.isfinite(value):
        raise ValueError(f"{value} must not be sent to the controller")
    return repr(value)


def parse_reply(line: bytes) -> Reply:
    """Returns what a line without its line feed says; whatever is no reply of the toolbox is `Kind.FOREIGN`."""
    text = line.decode("ascii", "backslashreplace")
    if len(line) > MAX_LINE:
        return Reply(text[:60], Kind.FOREIGN)
    if text in _KIND_OF_WORD:
        return Reply(text, _KIND_OF_WORD[text])
    if text in ("0", "1"):
        return Reply(text, Kind.PIN, (float(text),))
    fields = (text[:-1] if text.endswith("_") else text).split("_")
    if len(fields) in _KIND_OF_COUNT and all(_NUMBER.fullmatch(field) for field in fields):
        return Reply(text, _KIND_OF_COUNT[len(fields)], tuple(float(field) for field in fields))
    return Reply(repr(text)[1:61], Kind.FOREIGN)


class LineSplitter:
    """Cuts a stream of bytes into lines; empty lines vanish, overlong ones arrive shortened to `MAX_LINE` + 2 bytes."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Returns the lines that are complete with `data`, without CR and LF."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: MAX_LINE + 2]
        stripped = (line[: MAX_LINE + 2].rstrip(b"\r") for line in lines)
        return [line for line in stripped if line]


def _with_numbers(word: str, values: Iterable[float]) -> str:
    return "".join(f"{part}_" for part in (word, *map(number, values)))

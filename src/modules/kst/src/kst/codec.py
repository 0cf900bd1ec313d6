"""Wire text of the KUKA Sunrise Toolbox: commands to lines, bytes to replies. Pure. Millimetres and the angles A, B, C
of the wire end here: poses are 4x4 matrices in metres. Commands and their threads: docs/handbook/wire-protocols.md,
"Arm: Sunrise Toolbox"; those that no server understands, or that stop it, are left out."""

from __future__ import annotations

import contextlib
import enum
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kst.limits import check_pose

MAX_LINE = 1024  # longest line that counts as a reply [bytes]; 28 doubles in Java's longest text need about 700
MAX_TOOL_M = 1.0  # a tool point farther from the flange is refused: somebody mixed up millimetres and metres
STATE_FIELDS = 33  # of a `state`: the word, the mode, 28 numbers, operation mode, enabling, safety stop
OUTPUT_PINS = (1, 2, 11, 12)
INPUT_PINS = (3, 4, 10, 13, 16)
_DIGITS = b"0123456789.-E_"  # all that a line of finite numbers consists of
_NUMBER = re.compile(rb"[-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|Infinity)|NaN")


class ServerThread(enum.Enum):
    """Which of the server's two threads answers a command."""

    READER = "reader"
    MAIN = "main"


class ReplyKind(enum.Enum):
    """Kind of a reply, or of the reply that a command asks for."""

    NOTHING = "no answer"
    DONE = "done"
    NAK = "nak"
    INTERRUPTED = "interrupted"
    PIN = "0 or 1"
    THREE = "3 numbers"
    SIX = "6 numbers"
    SEVEN = "7 numbers"
    OK = "ok"
    NO = "no"
    STATE = "state"
    STOPPED = "stopped"
    EVENT = "event"
    BUSY = "busy"
    FOREIGN = "not a reply of the toolbox"


_SEVEN = 7 * "_%r" + "_"
_KIND_OF_COUNT = {3: ReplyKind.THREE, 6: ReplyKind.SIX, 7: ReplyKind.SEVEN}
_OF_APPLICATION = (ReplyKind.OK, ReplyKind.NO, ReplyKind.STATE, ReplyKind.STOPPED, ReplyKind.EVENT, ReplyKind.BUSY)
_KIND_OF_WORD = {kind.value: kind for kind in _OF_APPLICATION}


class KstCommand(NamedTuple):
    """One line to the server, without its line feed, and who answers it with which kind of reply."""

    line: str
    thread: ServerThread
    answer: ReplyKind

    @property
    def word(self) -> str:
        return self.line.split("_", 1)[0] if self.line.endswith("_") else self.line

    @property
    def starts_motion(self) -> bool:
        """Whether it starts a motion, which says a second word at its end."""
        return self.word in ("doPTPinJS", "doPTP!inJS", "lrGuide")

    def accepts(self, reply: KstReply) -> bool:
        """Returns whether a reply may be the answer; every command of the main thread may be refused by a `nak`. The
        robot application names the word that it accepts or refuses."""
        kind = reply.kind
        if kind is ReplyKind.OK or kind is ReplyKind.NO:
            return (kind is ReplyKind.NO or self.answer is kind) and reply.fields[:1] == (self.word,)
        if kind is ReplyKind.STOPPED:
            return self.word == "startDirectServoJoints"
        return kind is self.answer or (kind is ReplyKind.NAK and self.thread is ServerThread.MAIN)


class KstReply(NamedTuple):
    """One line from the server: its printable text, its kind, and its numbers in wire units."""

    text: str
    kind: ReplyKind
    numbers: tuple[float, ...] = ()

    @property
    def fields(self) -> tuple[str, ...]:
        """What follows the first word, as text."""
        return tuple(self.text.rstrip("_").split("_")[1:])

    @property
    def reason(self) -> str:
        """Why, in the words of the robot application; a part of a sentence."""
        return "_".join(self.fields[self.kind is ReplyKind.NO :])


_REPLIES = {
    b"done": KstReply("done", ReplyKind.DONE),
    b"nak": KstReply("nak", ReplyKind.NAK),
    b"interrupted": KstReply("interrupted", ReplyKind.INTERRUPTED),
    b"0": KstReply("0", ReplyKind.PIN, (0.0,)),
    b"1": KstReply("1", ReplyKind.PIN, (1.0,)),
}


@dataclass(frozen=True, eq=False)
class ToolTransform:
    """Pose of the tool in the flange, shape (4, 4) [m]; ValueError: not rigid, or farther away than `MAX_TOOL_M`."""

    T_flange_tool: np.ndarray

    def __post_init__(self) -> None:
        T = check_pose(self.T_flange_tool)
        object.__setattr__(self, "T_flange_tool", T)
        if np.linalg.norm(T[:3, 3]) > MAX_TOOL_M:
            raise ValueError(
                f"the tool point {T[:3, 3].tolist()} m is more than {MAX_TOOL_M:g} m from the flange; give metres"
            )


class Feedback(enum.Enum):
    """What the server returns on a joint servo goal: the command's prefix and the kind of the answer. Servers before
    May 2019 know neither POSE, which they answer with the force, nor FORCE."""

    DONE = ("jp", ReplyKind.DONE)
    NOTHING = ("jf", ReplyKind.NOTHING)
    JOINTS = ("jpJP", ReplyKind.SEVEN)
    EXTERNAL_TORQUES = ("jpExT", ReplyKind.SEVEN)
    MEASURED_TORQUES = ("jpMT", ReplyKind.SEVEN)
    POSE = ("jpEEfP", ReplyKind.SIX)
    FORCE = ("jpEEfFrelEEF", ReplyKind.THREE)
    STATE = ("jpState", ReplyKind.STATE)  # of the robot application alone


JOINTS = KstCommand("getJointsPositions", ServerThread.READER, ReplyKind.SEVEN)
EXTERNAL_TORQUES = KstCommand("Torques_ext_J", ServerThread.MAIN, ReplyKind.SEVEN)
MEASURED_TORQUES = KstCommand("Torques_m_J", ServerThread.MAIN, ReplyKind.SEVEN)
POSE = KstCommand("Eef_pos", ServerThread.MAIN, ReplyKind.SIX)
FORCE = KstCommand("Eef_force", ServerThread.MAIN, ReplyKind.THREE)
MOMENT = KstCommand("Eef_moment", ServerThread.MAIN, ReplyKind.THREE)
START_PTP = KstCommand("doPTPinJS", ServerThread.MAIN, ReplyKind.DONE)
GUARDED_PTP = KstCommand("doPTP!inJS", ServerThread.MAIN, ReplyKind.DONE)
"""A motion that nothing ends before its goal; the server moves nothing then and says `done` twice."""
START_SERVO = KstCommand("startDirectServoJoints", ServerThread.MAIN, ReplyKind.DONE)
STOP_SERVO = KstCommand("stopDirectServoJoints", ServerThread.READER, ReplyKind.DONE)
END = KstCommand("end", ServerThread.READER, ReplyKind.NOTHING)


def attach_tool(tool: ToolTransform) -> KstCommand:
    """Returns the command after which the server reports pose, force and moment of `tool`."""
    return KstCommand(_with_numbers("TFtrans", fields_from_pose(tool.T_flange_tool)), ServerThread.MAIN, ReplyKind.DONE)


def relative_velocity(velocity: float) -> KstCommand:
    """Returns the command that sets the speed of the next PTP motion, as a fraction of the greatest."""
    return KstCommand(_with_numbers("jRelVel", (velocity,)), ServerThread.MAIN, ReplyKind.DONE)


def start_guarded_ptp(torques: ArrayLike) -> KstCommand:
    """Returns the command that starts a PTP motion which ends where an external joint torque leaves its range.

    Args:
        torques: lowest and highest torque of each joint, shape (7, 2) [Nm], finite and in order; else ValueError."""
    ranges = np.asarray(torques, dtype=float)
    if ranges.shape != (7, 2) or not np.all(ranges[:, 0] < ranges[:, 1]):
        raise ValueError(f"the ranges of the torques are {ranges.tolist()}, but must be seven pairs, lowest first")
    fields = (str(field) for joint, (low, high) in enumerate(ranges) for field in (joint, number(low), number(high)))
    return GUARDED_PTP._replace(line=f"{GUARDED_PTP.line}_{'_'.join(fields)}_")


def joint_goal(q: Iterable[float], feedback: Feedback = Feedback.DONE) -> KstCommand:
    """Returns the command that sets the goal of the joint servo or of the next PTP to q, shape (7,) [rad]."""
    angles = tuple(map(float, q))
    if not all(map(math.isfinite, angles)):
        raise ValueError(f"{angles} would stop the server's reader thread; nothing was sent")
    prefix, answer = feedback.value
    return KstCommand(prefix + _SEVEN % angles, ServerThread.READER, answer)


def blue(on: bool) -> KstCommand:
    """Returns the command for the blue light of the media flange."""
    return KstCommand("blueOn" if on else "blueOff", ServerThread.READER, ReplyKind.DONE)


def set_pin(number: int, on: bool) -> KstCommand:
    """Returns the command for an output of connector X3; ValueError: none such, the server would not answer."""
    if number not in OUTPUT_PINS:
        raise ValueError(f"there is no output pin {number!r}; the outputs are {OUTPUT_PINS}")
    return KstCommand(f"pin{number}{'on' if on else 'off'}", ServerThread.READER, ReplyKind.DONE)


def get_pin(number: int) -> KstCommand:
    """Returns the command that reads an input of connector X3; ValueError: none such, the server would not answer."""
    if number not in INPUT_PINS:
        raise ValueError(f"there is no input pin {number!r}; the inputs are {INPUT_PINS}")
    return KstCommand(f"getPin{number}", ServerThread.READER, ReplyKind.PIN)


def fields_from_pose(T: np.ndarray) -> tuple[float, ...]:
    """Returns x, y, z [mm], A about Z, B about Y, C about X [rad] of the pose T, shape (4, 4) [m]."""
    return (*(1000.0 * T[:3, 3]), *zyx_from_rotation(T[:3, :3]))


def pose_from_fields(fields: Iterable[float]) -> np.ndarray:
    """Returns the pose, shape (4, 4) [m], of x, y, z [mm], A, B, C [rad]."""
    x, y, z, a, b, c = fields
    T = np.eye(4)
    T[:3, :3] = rotation_from_zyx(a, b, c)
    T[:3, 3] = x / 1000.0, y / 1000.0, z / 1000.0
    return T


def rotation_from_zyx(a: float, b: float, c: float) -> np.ndarray:
    """Returns Rz(a) Ry(b) Rx(c), shape (3, 3)."""
    (sa, sb, sc), (ca, cb, cc) = np.sin((a, b, c)), np.cos((a, b, c))
    return np.array(
        [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc],
        ]
    )


def zyx_from_rotation(R: np.ndarray) -> tuple[float, float, float]:
    """Returns a, b, c with R = Rz(a) Ry(b) Rx(c), b in [-pi/2, pi/2]; at |b| = pi/2 one of the many solutions."""
    a = math.atan2(R[1, 0], R[0, 0])
    b = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    sa, ca = math.sin(a), math.cos(a)
    c = math.atan2(sa * R[0, 2] - ca * R[1, 2], ca * R[1, 1] - sa * R[0, 1])
    return a + 0.0, b + 0.0, c + 0.0  # no -0.0


def number(value: float) -> str:
    """Returns the shortest text that Java reads back as the same double; ValueError: not finite."""
    value = float(value)
    if not math.isfinite(value):
        raise ValueError(f"{value} stops the server's reader thread; nothing was sent")
    return repr(value)


def parse_reply(line: bytes) -> KstReply:
    """Returns the reply in a line without its line feed; what is not a reply of the toolbox is `ReplyKind.FOREIGN`."""
    known = _REPLIES.get(line)
    if known is not None:
        return known
    text = line.decode("ascii", "backslashreplace")
    if len(line) > MAX_LINE:
        return KstReply(text[:60], ReplyKind.FOREIGN)
    fields = (line[:-1] if line.endswith(b"_") else line).split(b"_")
    kind = _KIND_OF_COUNT.get(len(fields))
    if kind is not None and (not line.translate(None, _DIGITS) or all(map(_NUMBER.fullmatch, fields))):
        with contextlib.suppress(ValueError):
            return KstReply(text, kind, tuple(map(float, fields)))
    kind = _KIND_OF_WORD.get(text.split("_", 1)[0]) if text.endswith("_") else None
    if kind is ReplyKind.STATE:
        if len(fields) == STATE_FIELDS:
            with contextlib.suppress(ValueError):
                return KstReply(text, kind, tuple(map(float, fields[2 : STATE_FIELDS - 3])))
    elif kind is not None:
        return KstReply(text, kind)
    return KstReply(repr(text)[1:-1][:60], ReplyKind.FOREIGN)


class KstLineSplitter:
    """Cuts a stream of bytes into lines; drops empty lines and shortens overlong ones to `MAX_LINE` + 2 bytes."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Returns the lines that are complete with `data`, without CR and LF."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: MAX_LINE + 2]
        return [line for line in [line[: MAX_LINE + 2].rstrip(b"\r") for line in lines] if line]


def _with_numbers(word: str, values: Iterable[float]) -> str:
    return "".join(f"{part}_" for part in (word, *map(number, values)))

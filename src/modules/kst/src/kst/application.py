"""The words that the robot application adds to the toolbox's (src/modules/sunrise_application/README.md), what it
answers, and the second connection by which it is stopped. Metres and kilograms; millimetres end here."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kst.codec import (
    STATE_FIELDS,
    KstCommand,
    KstReply,
    ReplyKind,
    ServerThread,
    ToolTransform,
    fields_from_pose,
    number,
)
from kst.errors import KstError
from kst.transport import LEAP_RIG, KstTransport

VERSION = "1"
ABILITIES = ("watchdog", "stop", "contact", "tool", "soft", "float", "guide", "state")
BRAKE_S = (0.05, 2.0)  # range of the silence after which the robot brakes [s]
END_S = 60.0  # longest silence after which servo mode may end [s]
SEND_S = 0.2  # longest wait to send a stop [s]


def _word(word: str, *values: float, thread: ServerThread = ServerThread.READER) -> KstCommand:
    return KstCommand("".join(f"{part}_" for part in (word, *map(number, values))), thread, ReplyKind.OK)


HELLO = KstCommand(f"lrHello_{VERSION}_", ServerThread.READER, ReplyKind.OK)
BEAT = _word("lrBeat")
STATE = KstCommand("lrState_", ServerThread.READER, ReplyKind.STATE)
STOP = _word("lrStop")
PAUSE = _word("lrPause")
RESUME = _word("lrResume")
STIFF = _word("lrStiff", thread=ServerThread.MAIN)
GUIDE = _word("lrGuide", thread=ServerThread.MAIN)


@dataclass(frozen=True)
class ApplicationSettings:
    """What the robot application is to know; ValueError: out of range."""

    brake_after: float = 0.2  # it brakes, or stops the motion, after this silence of the client [s]
    end_after: float = 10.0  # servo mode ends after this [s]
    tool_mass: float = 0.0  # of what is on the flange [kg]; 0: not known
    tool_centre: Sequence[float] = (0.0, 0.0, 0.0)  # centre of that mass in the flange frame [m]

    def __post_init__(self) -> None:
        low, high = BRAKE_S
        if not low <= self.brake_after <= high or not self.brake_after < self.end_after <= END_S:
            raise ValueError(
                f"the watchdog's times are {self.brake_after:g} s and {self.end_after:g} s, but must be {low:g} to"
                f" {high:g} s, and above that at most {END_S:g} s"
            )


@dataclass(frozen=True)
class SoftSettings:
    """How the tool yields in servo mode: springs along and about its axes, and limits at which servo mode ends."""

    stiffness: float  # along the axes [N/m]
    turning_stiffness: float  # about the axes [Nm/rad]
    damping: float  # of the springs, 1: critical
    force: float  # greatest along an axis [N]
    moment: float  # greatest about an axis [Nm]
    path: float  # farthest from the commanded path along an axis [m]


class Hello(NamedTuple):
    """How the robot application answers a hello."""

    version: str
    session: str  # the number by which a second connection joins
    abilities: frozenset[str]


class RobotState(NamedTuple):
    """All that the robot application measures, at one time."""

    mode: str  # IDLE, MOTION, PAUSED, SERVO or HELD
    joints: np.ndarray  # shape (7,) [rad]
    torques_measured: np.ndarray  # shape (7,) [Nm]
    torques_external: np.ndarray  # shape (7,) [Nm]
    force: np.ndarray  # at the tool point, in its axes, shape (3,) [N]
    moment: np.ndarray  # likewise, shape (3,) [Nm]
    longest_cycle: float  # of the application lately [s]
    operation_mode: str  # such as T1 or AUT
    enabling: str
    safety_stop: str  # NOSTOP, or its kind


def parse_hello(reply: KstReply) -> Hello | None:
    """Returns the hello in an answer to HELLO; None for any other answer."""
    fields = reply.fields
    if len(fields) < 4 or fields[:2] != ("lrHello", "leapRig") or not re.fullmatch(r"\d{1,9}", fields[3]):
        return None
    return Hello(fields[2], fields[3], frozenset(fields[4:]))


def state_of(reply: KstReply, numbers: np.ndarray) -> RobotState:
    """Returns the state in a reply of the kind STATE, whose numbers are finite."""
    parts = np.split(numbers, (7, 14, 21, 24, 27))
    mode, *rest = reply.text.split("_")[1:STATE_FIELDS]
    operation_mode, enabling, safety_stop = rest[-3:]
    joints, measured, external, force, moment, cycle = parts
    return RobotState(
        *(mode, joints, measured, external, force, moment, float(cycle[0]) / 1000.0),
        *(operation_mode, enabling, safety_stop),
    )


def watchdog(settings: ApplicationSettings) -> KstCommand:
    """Returns the command that sets the times of the watchdog."""
    return _word("lrWatchdog", settings.brake_after, settings.end_after)


def weigh_tool(settings: ApplicationSettings, tool: ToolTransform) -> KstCommand:
    """Returns the command that attaches the tool with its mass."""
    centre = (1000.0 * x for x in settings.tool_centre)
    fields = fields_from_pose(tool.T_flange_tool)
    return _word("lrTool", settings.tool_mass, *centre, *fields, thread=ServerThread.MAIN)


def weigh_load(mass: float, centre: Iterable[float]) -> KstCommand:
    """Returns the command that adds a held load: its mass [kg], and its centre in the flange frame [m]."""
    return _word("lrLoad", mass, *(1000.0 * x for x in centre), thread=ServerThread.MAIN)


def soften(soft: SoftSettings) -> KstCommand:
    """Returns the command that makes the next servo modes soft; what the tool's axes leave free stays loosely."""
    turned_rad, null_space = 1.0, 20.0  # farthest about an axis; stiffness of the elbow's swivel [Nm/rad]
    springs = (*(soft.stiffness,) * 3, *(soft.turning_stiffness,) * 3, soft.damping, null_space)
    limits = soft.force, soft.moment, 1000.0 * soft.path, turned_rad
    return _word("lrSoftTool", *springs, *limits, thread=ServerThread.MAIN)


def numbers_of(reply: KstReply) -> tuple[float, ...] | None:
    """Returns the numbers with which a word was accepted; None if they are none."""
    with contextlib.suppress(ValueError):
        return tuple(map(float, reply.fields[1:]))
    return None


class StopChannel:
    """The second connection to the robot application: `stop` from any thread, at any time; `events` from one."""

    def __init__(self, host: str, port: int, session: str, timeout: float) -> None:
        self._address = host, port
        self._transport = KstTransport.connect(host, port, timeout, LEAP_RIG)
        self._transport.send(f"lrChannel_{session}_", timeout)
        answer = self._transport.receive(self._transport.monotonic() + timeout)
        if answer is None or answer.kind is not ReplyKind.OK:
            self.close()
            said = "nothing" if answer is None else f"`{answer.text}`"
            raise KstError(
                f"the second connection to {host}:{port} was answered by {said}; nothing could be stopped by it"
            )

    def stop(self) -> None:
        """Stops whatever moves; raises KstError: the word could not be sent. Anybody may say it, so a lost channel is
        replaced by a new connection."""
        try:
            self._transport.send(STOP.line, SEND_S)
        except (KstError, RuntimeError):  # two threads may have waited for the same socket
            other = KstTransport.connect(*self._address, SEND_S, LEAP_RIG)
            other.send(STOP.line, SEND_S)
            other.receive(other.monotonic() + SEND_S)  # a socket closed before could take the word back

    def events(self) -> list[str]:
        """Returns what the robot has said unasked since the last call, parts of sentences; does not wait."""
        try:
            return [reply.reason for reply in self._transport.waiting() if reply.kind is ReplyKind.EVENT]
        except KstError:
            return []

    def close(self) -> None:
        self._transport.close()
        self._transport.close()  # the second one closes the socket at once: nothing more is said

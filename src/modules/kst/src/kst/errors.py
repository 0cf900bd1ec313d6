"""What can go wrong between a program and the arm's controller: one class per reaction it calls for. Each error
carries its values as attributes; an attribute that does not apply keeps the default of its class."""

from __future__ import annotations

from typing import Any


class KstError(Exception):
    """Base of the errors of this package; keyword arguments become attributes. `pending`: the command may take
    effect all the same."""

    pending: bool = False

    def __init__(self, message: str, **values: Any) -> None:
        super().__init__(message)
        vars(self).update(values)


class NoServer(KstError):
    """Nobody listens at `address`, or the connection ended without a word: the application is not running."""

    address: str = ""


class ForeignServer(KstError):
    """What answers at `address` is neither the toolbox's server nor the robot application: it says `answer`, its first
    bytes."""

    address: str = ""
    answer: bytes = b""


class ServerBusy(KstError):
    """The port at `address` is open but silent: another client is connected, or the server no longer reads."""

    address: str = ""


class ToolNotAttached(KstError):
    """The server did not attach the tool: the poses it would report are not those of the tool."""


class ReplyTimeout(KstError):
    """`command` was not answered in time; the link itself may be sound."""

    command: str = ""


class ConnectionLost(KstError):
    """The link is gone for good; only a new connection helps."""


class MotionRefused(KstError):
    """The controller answered `nak`: it did not carry out the request."""


class NotLeapRig(KstError):
    """The server at `address` does not know the words of the robot application, or another version of them."""

    address: str = ""


class WordRefused(KstError):
    """The robot application refused `command`; the message says why."""

    command: str = ""


class MotionStopped(KstError):
    """The robot application has stopped what moved, because of `reason`, a part of a sentence."""

    reason: str = ""


class MotionInterrupted(KstError):
    """A PTP motion ended before its goal because an external joint torque left its range: the arm touched something.
    `torques`: external torques where it stands, shape (7,) [Nm]; None: they could not be read."""

    torques: Any = None


class UnexpectedReply(KstError):
    """The server answered `command` with `reply`, which does not belong to it."""

    command: str = ""
    reply: str = ""


class WrongMode(KstError):
    """The server would never answer this command in the present `mode`, so the client did not send it."""

    mode: Any = None


class BadJoints(KstError, ValueError):
    """Joint angles that were not sent: not seven finite numbers, or `joint` (1 to 7) outside its range."""

    joint: int = 0


class BadVelocity(KstError, ValueError):
    """A relative velocity that is not in (0, 1]; it was not sent."""


class PtpFailed(KstError):
    """A PTP motion ended before its goal, stands still or takes too long; `progress` is its last observation."""

    progress: Any = None

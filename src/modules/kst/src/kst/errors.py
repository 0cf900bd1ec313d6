"""What can go wrong between the rig and the arm's controller, one class per reaction it calls for."""

from __future__ import annotations

from common.errors import DeviceError


class NoServer(DeviceError):
    """Nobody listens at the address, or the server ended at once: its application is not running."""


class ServerBusy(DeviceError):
    """The port is open and stays silent: somebody else is connected, or the server has gone deaf."""


class ToolNotAttached(DeviceError):
    """The server did not attach the tool: the poses it would report are not those of the tool."""


class ReplyTimeout(DeviceError):
    """A command was not answered in time; the link itself may be sound."""


class ConnectionLost(DeviceError):
    """The link is gone for good; only a new connection helps."""


class MotionRefused(DeviceError):
    """The controller answered `nak`: it did not carry out what was asked."""


class ProtocolError(DeviceError):
    """The server answered something that does not belong to the command."""


class WrongMode(DeviceError):
    """The server would never answer this command in the present mode, so it was not sent."""


class BadJoints(DeviceError, ValueError):
    """Joint angles that must not be sent: not seven finite numbers, or outside the joint ranges."""


class BadVelocity(DeviceError, ValueError):
    """A relative velocity that is not in (0, 1]; it was not sent."""

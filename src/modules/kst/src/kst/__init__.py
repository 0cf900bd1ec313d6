"""Client of the KUKA Sunrise Toolbox server on an iiwa's controller; needs numpy only. `client` is the interface,
over `session` (pairs answers with commands), `transport` (socket), `codec` (wire text)."""

from __future__ import annotations

from kst.application import ApplicationSettings, RobotState, SoftSettings
from kst.client import KstClient, KstMode
from kst.codec import Feedback, ToolTransform
from kst.errors import (
    BadJoints,
    BadVelocity,
    ConnectionLost,
    ForeignServer,
    KstError,
    MotionInterrupted,
    MotionRefused,
    MotionStopped,
    NoServer,
    NotLeapRig,
    PtpFailed,
    ReplyTimeout,
    ServerBusy,
    ToolNotAttached,
    UnexpectedReply,
    WordRefused,
    WrongMode,
)
from kst.limits import LBR_IIWA_LIMITS, JointLimits
from kst.ptp import PtpApproach, PtpLimits, PtpProgress, PtpState, PtpSupervisor
from kst.ptp_client import read_joints, run_ptp
from kst.session import KstTiming, LinkCounts

__all__ = [
    "LBR_IIWA_LIMITS", "ApplicationSettings", "BadJoints", "BadVelocity", "ConnectionLost", "Feedback",
    "ForeignServer", "JointLimits", "KstClient", "KstError", "KstMode", "KstTiming", "LinkCounts",
    "MotionInterrupted", "MotionRefused", "MotionStopped", "NoServer", "NotLeapRig", "PtpApproach", "PtpFailed",
    "PtpLimits", "PtpProgress", "PtpState", "PtpSupervisor", "ReplyTimeout", "RobotState", "ServerBusy", "SoftSettings",
    "ToolNotAttached", "ToolTransform", "UnexpectedReply", "WordRefused", "WrongMode", "read_joints", "run_ptp",
]  # fmt: skip

"""Client of the KUKA Sunrise Toolbox server on an iiwa's controller; needs numpy only. `client` is the interface,
over `session` (pairs answers with commands), `transport` (socket), `codec` (wire text)."""

from __future__ import annotations

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
    NoServer,
    PtpFailed,
    ReplyTimeout,
    ServerBusy,
    ToolNotAttached,
    UnexpectedReply,
    WrongMode,
)
from kst.limits import LBR_IIWA_LIMITS, JointLimits
from kst.ptp import PtpApproach, PtpLimits, PtpProgress, PtpState, PtpSupervisor
from kst.ptp_client import read_joints, run_ptp
from kst.session import KstTiming, LinkCounts

__all__ = [
    "LBR_IIWA_LIMITS", "BadJoints", "BadVelocity", "ConnectionLost", "Feedback", "ForeignServer", "JointLimits",
    "KstClient", "KstError", "KstMode", "KstTiming", "LinkCounts", "MotionInterrupted", "MotionRefused", "NoServer",
    "PtpApproach", "PtpFailed", "PtpLimits", "PtpProgress", "PtpState", "PtpSupervisor", "ReplyTimeout",
    "ServerBusy", "ToolNotAttached", "ToolTransform", "UnexpectedReply", "WrongMode", "read_joints", "run_ptp",
]  # fmt: skip

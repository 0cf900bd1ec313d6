"""Runs a point-to-point motion under supervision: start, readings, end."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from kst.client import KstClient
from kst.errors import PtpFailed, ReplyTimeout, UnexpectedReply
from kst.ptp import PtpLimits, PtpProgress, PtpState, PtpSupervisor

ONE_READING = (ReplyTimeout, UnexpectedReply)  # errors of one answer on a link that may be sound


def read_joints(client: KstClient, tries: int = PtpLimits.missed) -> np.ndarray:
    """Returns the measured joints, shape (7,) [rad]; up to `tries` answers may be missing or unusable."""
    for _ in range(tries - 1):
        try:
            return client.joints()
        except ONE_READING:
            continue
    return client.joints()


def run_ptp(
    client: KstClient,
    q: ArrayLike,
    velocity: float,
    limits: PtpLimits | None = None,
    report: Callable[[PtpProgress, np.ndarray], None] = lambda progress, joints: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> PtpProgress:
    """Moves the arm to q, shape (7,) [rad], at `velocity`, a fraction of full speed; returns the last progress. Raises
    PtpFailed: the arm stands still or moves for too long, or the motion ended before its goal; ReplyTimeout,
    UnexpectedReply: too many answers in a row did not come or were unusable; BadJoints, BadVelocity, MotionRefused,
    WrongMode, ConnectionLost: as for `KstClient.start_ptp_joints`.

    Args:
        limits: bounds of the motion.
        report: called with each progress and the joints, shape (7,) [rad], that were read.
        interrupted: whether to wait no longer; the arm then continues to its goal, because the toolbox cannot stop it.

    Returns:
        Progress with the state ARRIVED or INTERRUPTED."""
    limits = PtpLimits() if limits is None else limits
    joints = read_joints(client, limits.missed)
    client.start_ptp_joints(q, velocity)
    supervisor = PtpSupervisor(joints, np.asarray(q, dtype=float), client.monotonic(), limits)
    arrived = False
    while True:
        try:
            arrived = arrived or client.ptp_arrived()
            joints = client.joints()
        except ONE_READING:
            if interrupted():
                return supervisor.observe(joints, client.monotonic(), interrupted=True)
            if supervisor.miss():
                raise
            client.pause(limits.period)
            continue
        progress = supervisor.observe(joints, client.monotonic(), arrived, interrupted())
        report(progress, joints)
        if progress.state in (PtpState.ARRIVED, PtpState.INTERRUPTED):
            return progress
        if progress.state not in (PtpState.MOVING, PtpState.STALLED):
            raise PtpFailed(_failure(progress), progress=progress)
        client.pause(limits.period)


def _failure(progress: PtpProgress) -> str:
    away = f"{math.degrees(progress.remaining):.1f} deg before its goal (joint {progress.joint})"
    if progress.state is PtpState.SHORT:
        return f"the motion ended {away}; look at the smartPad for the reason"
    pending = "the motion is still pending on the robot: end the server on the smartPad before releasing the arm"
    if progress.state is PtpState.GIVEN_UP:
        return f"the arm has not moved for {progress.still:.0f} s, {away}; {pending}"
    return f"the arm did not arrive in time, {away}; {pending}"

"""Chooses the grasp to execute on request and computes where the tool goes, or gives the reason for a refusal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasping.pipeline.rig_configuration import grasp_in_tool
from grasping.pipeline.tool_pose import ToolPoseConfig, above, tool_pose

NOT_STARTED, ENDING, STOPPED = "starting", "zero", "stopped"
UNABLE = (NOT_STARTED, ENDING, STOPPED)
"""Modes of the arm's controller in which it follows no desired tool frame."""


@dataclass(frozen=True)
class ProposedPose:
    """A proposed grasp."""

    id: int  # its number
    T_base_grasp: np.ndarray | None  # shape (4, 4) [m]; None where it is unknown
    reason: str = "the camera pose is unknown"  # why it is unknown, a clause


@dataclass(frozen=True)
class ProposalList:
    """The grasps in the newest image, best first."""

    age: float  # of the image [s]
    grasps: Sequence[ProposedPose]  # what is proposed; those that the arm's controller refused come last
    reason: str = ""  # why nothing is


@dataclass(frozen=True)
class ControllerState:
    """The published state of the arm's controller: whether control is on, its mode, and the reason for it."""

    control_on: bool
    mode: str
    reason: str


@dataclass(frozen=True)
class Refusal:
    """Why no grasp is executed, one sentence."""

    sentence: str


@dataclass(frozen=True)
class ToolGoal:
    """Where the tool goes."""

    T_base_tool: np.ndarray  # the tool that takes the grasp, shape (4, 4) [m]
    T_base_above: np.ndarray  # where it waits for the hand, shape (4, 4) [m]
    T_base_grip: np.ndarray  # the grasp between the fingers then, shape (4, 4) [m]: x through them, z the approach


def choose(
    proposals: ProposalList | None, controller: ControllerState | None, hand_followed: bool, fresh: float
) -> ProposedPose | Refusal:
    """Returns the best grasp, or why there is none.

    Args:
        proposals: the newest; None if none came yet.
        controller: its newest state; None if it is silent.
        fresh: proposals in an older image are refused [s].
    """
    if controller is None:
        return Refusal("The arm's controller is silent.")
    if not controller.control_on:
        return Refusal("Control of the arm is off.")
    if controller.mode in UNABLE:
        return Refusal(f"The arm cannot go there: {controller.reason}")
    if hand_followed:
        return Refusal("The arm follows a hand; take it away first.")
    if proposals is None:
        return Refusal("No grasp was proposed yet.")
    if not -fresh <= proposals.age <= fresh:
        return Refusal(f"The newest proposal is {proposals.age:.1f} s old.")
    if not proposals.grasps:
        return Refusal(f"No grasp is proposed: {proposals.reason or 'the list is empty'}.")
    best = proposals.grasps[0]
    return best if best.T_base_grasp is not None else Refusal(f"The pose of the grasp is unknown: {best.reason}.")


def tool_goal(
    T_base_grasp: np.ndarray, settings: ToolPoseConfig, R_home: np.ndarray, up: np.ndarray
) -> ToolGoal | Refusal:
    """Returns where the tool goes for a grasp.

    Args:
        T_base_grasp: shape (4, 4) [m].
        R_home: orientation of the home tool, R_base_tool, shape (3, 3); of two possible ones the nearer is taken.
        up: the vertical in the base frame, shape (3,).
    """
    try:
        T_base_tool = tool_pose(T_base_grasp, settings, R_home, up)
    except ValueError as error:
        return Refusal(f"The hand cannot take the grasp: {error}.")
    return ToolGoal(T_base_tool, above(T_base_tool, settings.clearance), T_base_tool @ grasp_in_tool(settings))

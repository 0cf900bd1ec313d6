"""Whether the tool can be brought to a pose, by the very steps that bring it to a desired tool frame. Nothing moves.

The answer holds for the joints from which the arm would go there: those that it has while it follows the desired tool
frame, else those of the home position, since it always goes there first. It does not check the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kuka_control.model.desired_frame import rejection_reason
from kuka_control.model.mode import Mode
from kuka_control.model.target import TargetChain
from kuka_control.model.workspace import Infeasible

FOLLOWING = (Mode.PICK_UP, Mode.SERVO)
"""Modes in which the arm follows the desired tool frame from where it is."""


@dataclass(frozen=True)
class ToolCheck:
    """The answer.

    Attributes:
        sentence: why the tool cannot be brought there, or that it can.
        T_base_desired: what the desired tool frame has to be for that, shape (4, 4) [m]; None if it cannot.
    """

    sentence: str
    T_base_desired: np.ndarray | None = None


def seed(mode: Mode, joints: np.ndarray | None, q_home: np.ndarray) -> np.ndarray:
    """Returns the joints from which the arm would go to a pose, shape (7,) [rad].

    Args:
        mode: of the controller.
        joints: measured, shape (7,) [rad]; None before they were read.
        q_home: home position, shape (7,) [rad].
    """
    return joints if mode in FOLLOWING and joints is not None else q_home


def check_tool_pose(chain: TargetChain, T_base_tool: np.ndarray, scale: float, q_seed: np.ndarray) -> ToolCheck:
    """Returns whether the tool can be brought to a pose.

    Args:
        chain: from the desired tool frame to joints.
        T_base_tool: the pose, shape (4, 4) [m].
        scale: scaling factor.
        q_seed: joints from which the arm would go there, shape (7,) [rad].
    """
    reason = rejection_reason(T_base_tool)
    if reason is not None:
        return ToolCheck(f"The tool pose is refused: {reason}")
    target = chain.reach(T_base_tool, q_seed)
    if isinstance(target, Infeasible):
        return ToolCheck(f"The tool pose is outside the workspace: {target}.")
    if target.bounds:
        moved = 1e3 * np.linalg.norm(target.T_base_tool[:3, 3] - T_base_tool[:3, 3])
        return ToolCheck(
            f"The tool pose is outside the workspace: the {' and the '.join(target.bounds)} would move it by "
            f"{moved:.0f} mm."
        )
    if target.failure is not None:
        return ToolCheck(target.failure)
    return ToolCheck("The arm can bring the tool there.", chain.desired(T_base_tool, scale))

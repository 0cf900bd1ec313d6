"""From the desired tool frame to a joint target: scaling, workspace, inverse kinematics.

The scaling factor says how far the tool moves for a motion of the hand, from the workspace centre; rotations are not
scaled. Positions in the base frame [m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import pose, read_only
from iiwa_kinematics import Kinematics
from kuka_control.model.desired_frame import rejection_reason
from kuka_control.model.switches import Mode
from kuka_control.model.workspace import Infeasible, Workspace

FOLLOWING = (Mode.PICK_UP, Mode.SERVO)  # modes in which the arm follows the desired tool frame from where it is


def scaled(position: np.ndarray, centre: np.ndarray, factor: float) -> np.ndarray:
    """Returns the position, shape (3,), moved towards the centre (factor < 1) or away from it (factor > 1)."""
    return centre + factor * (position - centre)


def unscaled(position: np.ndarray, centre: np.ndarray, factor: float) -> np.ndarray:
    """Returns the position, shape (3,), that `scaled` brings to the given one."""
    return centre + (position - centre) / factor


@dataclass(frozen=True)
class Target:
    """Where the arm is to go."""

    q: np.ndarray | None  # joints, shape (7,) [rad]; None when no valid solution reaches the tool frame
    T_base_tool: np.ndarray  # the tool frame after scaling and workspace, shape (4, 4) [m]
    bounds: tuple[str, ...] = ()  # names of the workspace's bounds that acted
    failure: str | None = None  # why there are no joints, a sentence; None when there are


class TargetChain:
    """Composes the steps from the desired tool frame to joints. It has no state, so any thread may ask it.

    `centre`: from which displacements are scaled, shape (3,) [m].
    """

    def __init__(self, centre: np.ndarray, workspace: Workspace, kinematics: Kinematics) -> None:
        self._centre = read_only(centre)
        self._workspace = workspace
        self._kinematics = kinematics

    def resolve(self, T_base_desired: np.ndarray, scale: float, q_seed: np.ndarray) -> Target | Infeasible:
        """Returns the target of a desired tool frame, shape (4, 4) [m].

        The solution continues from the joints `q_seed`, shape (7,) [rad]; `scale` is the scaling factor.
        """
        return self.reach(pose(T_base_desired[:3, :3], scaled(T_base_desired[:3, 3], self._centre, scale)), q_seed)

    def desired(self, T_base_tool: np.ndarray, scale: float) -> np.ndarray:
        """Returns the desired tool frame, shape (4, 4) [m], that the scaling makes the given one of."""
        return read_only(pose(T_base_tool[:3, :3], unscaled(T_base_tool[:3, 3], self._centre, scale)))

    def reach(self, T_base_scaled: np.ndarray, q_seed: np.ndarray) -> Target | Infeasible:
        """Returns the target of a tool frame that is scaled already; arguments as in `resolve`."""
        constrained = self._workspace.constrain(T_base_scaled[:3, 3])
        if isinstance(constrained, Infeasible):
            return constrained
        T_base_tool = read_only(pose(T_base_scaled[:3, :3], constrained.position))
        result = self._kinematics.inverse(T_base_tool, q_seed=q_seed, keep_branch=True)
        return Target(
            result.q,
            T_base_tool,
            tuple(bound.value for bound in constrained.bounds),
            None if result.failure is None else str(result.failure),
        )


@dataclass(frozen=True)
class ToolCheck:
    """The answer."""

    sentence: str  # why the tool cannot be brought there, or that it can
    T_base_desired: np.ndarray | None = None  # the desired tool frame for that, shape (4, 4) [m]; None if it cannot


def seed(mode: Mode, joints: np.ndarray | None, q_home: np.ndarray) -> np.ndarray:
    """Returns the joints from which the arm would go to a pose, shape (7,) [rad]; `joints` are the measured ones."""
    return joints if mode in FOLLOWING and joints is not None else q_home


def check_tool_pose(chain: TargetChain, T_base_tool: np.ndarray, scale: float, q_seed: np.ndarray) -> ToolCheck:
    """Returns whether the tool can be brought to a pose, shape (4, 4) [m], by the steps of a desired tool frame.

    The answer holds for the joints `q_seed`, shape (7,) [rad], from which the arm would go there: those that it has
    while it follows the desired tool frame, else those of the home position, since it always goes there first. It does
    not check the path.
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

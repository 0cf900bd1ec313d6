"""From the desired tool frame to a joint target: scaling, workspace, inverse kinematics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import pose, read_only
from iiwa_kinematics import Kinematics
from kuka_control.model.scaling import scaled, unscaled
from kuka_control.model.workspace import Infeasible, Workspace


@dataclass(frozen=True)
class Target:
    """Where the arm is to go.

    Attributes:
        q: joints, shape (7,) [rad]; None when no valid solution reaches the tool frame.
        T_base_tool: the tool frame after scaling and workspace, shape (4, 4) [m].
        bounds: names of the workspace's bounds that acted.
        failure: why there are no joints, a sentence; None when there are.
    """

    q: np.ndarray | None
    T_base_tool: np.ndarray
    bounds: tuple[str, ...] = ()
    failure: str | None = None


class TargetChain:
    """Composes the steps from the desired tool frame to joints. It has no state, so any thread may ask it.

    Args:
        centre: of the workspace, shape (3,) [m].
        workspace: where the tool point may be.
        kinematics: of the arm with its tool.
    """

    def __init__(self, centre: np.ndarray, workspace: Workspace, kinematics: Kinematics) -> None:
        self._centre = read_only(centre)
        self._workspace = workspace
        self._kinematics = kinematics

    def resolve(self, T_base_desired: np.ndarray, scale: float, q_seed: np.ndarray) -> Target | Infeasible:
        """Returns the target of a desired tool frame.

        Args:
            T_base_desired: shape (4, 4) [m].
            scale: scaling factor.
            q_seed: joints that the solution continues from, shape (7,) [rad].
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

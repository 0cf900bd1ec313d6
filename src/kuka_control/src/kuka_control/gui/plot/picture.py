"""The content of a picture of the workspace."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.rotations import rotation_about
from iiwa_kinematics import arm_points
from kuka_control.model.reach_study import ReachStudy
from kuka_control.model.rig import Rig
from kuka_control.model.workspace_samples import ConstrainedSamples


@dataclass(frozen=True, eq=False)
class WorkspacePicture:
    """Everything that is drawn.

    Attributes:
        title: one line above.
        notes: lines of text below.
        rig: the arm, its workspace and home.
        samples: positions that were constrained.
        reach: where the arm reaches.
    """

    title: str
    notes: tuple[str, ...]
    rig: Rig
    samples: ConstrainedSamples
    reach: ReachStudy

    @property
    def arm(self) -> np.ndarray:
        """Base, shoulder, elbow, wrist, flange and tool point at home, shape (6, 3) [m]."""
        return np.vstack([arm_points(self.rig.model, self.rig.home.q), self.rig.home.T_base_tool[:3, 3]])

    @property
    def unreached(self) -> np.ndarray:
        """Positions that the tool does not reach pointing straight down, shape (n, 3) [m]."""
        return self.reach.positions[~self.reach.down]


def in_section(points: np.ndarray) -> np.ndarray:
    """Returns each of the points as distance from the base axis and height, shape (n, 2) [m]."""
    return np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])


def in_home_plane(points: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray:
    """Returns the points in the vertical plane of the tool, shape (n, 2) [m]: towards the tool, and height.

    Args:
        points: shape (n, 3) [m].
        T_base_tool: the tool at home, shape (4, 4) [m].
    """
    turn = math.atan2(T_base_tool[1, 3], T_base_tool[0, 3])
    return (points @ rotation_about(2, turn))[:, [0, 2]]

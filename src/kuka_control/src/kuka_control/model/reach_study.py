"""How much of the workspace the arm can reach: a study over positions in it and orientations of the tool.

The tool points straight down as at the calculated home position, or is turned from there by yaw, pitch and roll within
the tolerances to which the hand's orientation is clipped. A pose counts as reached if any joints within their ranges
bring the tool there, however the arm is folded; collisions of the arm with itself, the table or the hand are not
looked at.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from common.mounting import MountingFrame
from common.poses import pose, read_only
from common.rotations import rotation_from_zyx
from iiwa_kinematics import IkFailure, Kinematics


@dataclass(frozen=True, eq=False)
class ReachStudy:
    """What was found.

    Attributes:
        positions: of the tool, shape (n, 3) [m].
        down: whether the tool gets there pointing straight down, shape (n,) of bool.
        fraction: of the orientations within the tolerances that it reaches, shape (n,), 0 to 1.
        failures: how often each reason kept the tool that points straight down from a position.
    """

    positions: np.ndarray
    down: np.ndarray
    fraction: np.ndarray
    failures: dict[IkFailure, int]

    @property
    def percent_down(self) -> float:
        """Percentage of the positions that the tool reaches pointing straight down."""
        return 100.0 * float(np.mean(self.down))

    @property
    def percent_within(self) -> float:
        """Percentage of the pairs of a position and an orientation within the tolerances that the tool reaches."""
        return 100.0 * float(np.mean(self.fraction))

    @property
    def percent_always(self) -> float:
        """Percentage of the positions that the tool reaches straight down and with every orientation that was tried."""
        return 100.0 * float(np.mean(self.down & (self.fraction == 1.0)))


def tool_rotation(mounting: MountingFrame, yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Returns R_base_tool, shape (3, 3), for a hand's yaw, pitch and roll [rad]; at zero that of the home pose."""
    return mounting.tool_from_hand(mounting.R_base_hand @ rotation_from_zyx(yaw, pitch, roll))


def study_reach(
    kinematics: Kinematics,
    mounting: MountingFrame,
    q_home: np.ndarray,
    positions: np.ndarray,
    tolerances: tuple[float, float, float],
    orientations: int,
    random: np.random.Generator,
) -> ReachStudy:
    """Returns which of the positions the arm reaches.

    Args:
        kinematics: of the arm with its tool.
        mounting: the operator's directions.
        q_home: joints that the search starts from, shape (7,) [rad].
        positions: of the tool, shape (n, 3) [m], n > 0.
        tolerances: greatest yaw, pitch and roll either way [rad].
        orientations: how many orientations are drawn at each position, at least 1.
        random: where the random numbers come from.

    Raises:
        ValueError: there is nothing to study.
    """
    if len(positions) < 1 or orientations < 1:
        raise ValueError(f"a study needs positions and orientations, not {len(positions)} and {orientations}")
    limits = np.asarray(tolerances, dtype=float)
    R_down = tool_rotation(mounting, 0.0, 0.0, 0.0)
    down, fraction = [], []
    failures: Counter[IkFailure] = Counter()
    for position in positions:
        straight = kinematics.inverse(pose(R_down, position), q_seed=q_home)
        down.append(straight.failure is None)
        if straight.failure is not None:
            failures[straight.failure] += 1
        drawn = random.uniform(-limits, limits, (orientations, 3))
        poses = (pose(tool_rotation(mounting, *angles), position) for angles in drawn)
        fraction.append(np.mean([kinematics.inverse(T, q_seed=q_home).failure is None for T in poses]))
    return ReachStudy(read_only(positions), np.array(down), read_only(fraction), dict(failures))

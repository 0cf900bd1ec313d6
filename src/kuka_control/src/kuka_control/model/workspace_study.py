"""Random positions in and around the workspace, how much of it the arm reaches, and the findings in sentences. Base
frame, metres. The random numbers come from the generator that is handed in, so equal seeds give equal samples."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.mounting import MountingFrame
from common.poses import pose, read_only
from common.rotations import rotation_from_zyx
from iiwa_kinematics import IkFailure, Kinematics
from kuka_control.model.config import ControllerConfig
from kuka_control.model.rig import Rig
from kuka_control.model.workspace import Infeasible, Workspace

SEVERAL = "several bounds"
UNCHANGED = "inside, unchanged"


@dataclass(frozen=True, eq=False)
class ConstrainedSamples:
    """Raw positions, and what the workspace makes of them."""

    raw: np.ndarray  # those that can be constrained, shape (n, 3) [m]
    position: np.ndarray  # what the workspace leaves of each, shape (n, 3) [m]
    acted: tuple[str, ...]  # for each which bound acted: its name, `SEVERAL` or `UNCHANGED`
    infeasible: np.ndarray  # the raw positions that no workspace is for, shape (m, 3) [m]

    def group(self, acted: str) -> np.ndarray:
        """Returns which samples the bound `acted` acted on alone, shape (n,) of bool."""
        return np.array([name == acted for name in self.acted], dtype=bool)


def constrained_samples(
    workspace: Workspace, count: int, random: np.random.Generator, margin: float = 0.12
) -> ConstrainedSamples:
    """Returns `count` positions in the workspace and up to `margin` [m] beyond each bound, constrained to it."""
    raw, position, acted, infeasible = [], [], [], []
    for _ in range(count):
        sample = _around(workspace, random, margin)
        result = workspace.constrain(sample)
        if isinstance(result, Infeasible):
            infeasible.append(sample)
            continue
        raw.append(sample)
        position.append(result.position)
        names = [bound.value for bound in result.bounds]
        acted.append(UNCHANGED if not names else names[0] if len(names) == 1 else SEVERAL)
    return ConstrainedSamples(_rows(raw), _rows(position), tuple(acted), _rows(infeasible))


def volume_samples(workspace: Workspace, count: int, random: np.random.Generator) -> np.ndarray:
    """Returns positions spread evenly over the volume of the workspace, shape (count, 3) [m]."""
    level = min(max(workspace.joint_2_height, workspace.z_lower), workspace.z_upper)
    widest = workspace.radii(level)[1]
    half = workspace.opening_angle / 2.0
    found: list[tuple[float, float, float]] = []
    while len(found) < count:
        z = random.uniform(workspace.z_lower, workspace.z_upper)
        # Evenly over a disc: its area grows with the square of the radius.
        r = widest * math.sqrt(random.uniform())
        turn = workspace.heading + random.uniform(-half, half)
        r_inner, r_outer = workspace.radii(z)
        if r_inner <= r <= r_outer:
            found.append((r * math.cos(turn), r * math.sin(turn), z))
    return _rows(found)


def _around(workspace: Workspace, random: np.random.Generator, margin: float) -> np.ndarray:
    """Returns a position in the workspace or up to `margin` beyond it, shape (3,) [m]."""
    z = random.uniform(workspace.z_lower - margin, workspace.z_upper + margin)
    r_inner, r_outer = workspace.radii(min(max(z, workspace.z_lower), workspace.z_upper))
    r = random.uniform(max(r_inner - margin, 0.0), r_outer + margin)
    half = workspace.opening_angle / 2.0 + margin / max(r, margin)
    turn = workspace.heading + random.uniform(-half, half)
    return np.array([r * math.cos(turn), r * math.sin(turn), z])


def _rows(points: list) -> np.ndarray:
    return read_only(np.reshape(points, (-1, 3)))


@dataclass(frozen=True, eq=False)
class ReachStudy:
    positions: np.ndarray  # of the tool, shape (n, 3) [m]
    down: np.ndarray  # whether the tool gets there pointing straight down, shape (n,) of bool
    fraction: np.ndarray  # of the orientations within the tolerances that it reaches, shape (n,), 0 to 1
    failures: dict[IkFailure, int]  # how often each reason kept the tool that points straight down from a position

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
    """Returns which of the positions of the tool, shape (n, 3) [m], n > 0, the arm reaches.

    The tool points straight down as at the calculated home position, or is turned from there by yaw, pitch and roll
    within the tolerances to which the hand's orientation is clipped. A pose counts as reached if any joints within
    their ranges bring the tool there, however the arm is folded; collisions of the arm with itself, the table or the
    hand are not looked at.

    Args:
        q_home: joints that the search starts from, shape (7,) [rad].
        tolerances: greatest yaw, pitch and roll either way [rad].
        orientations: how many are drawn at each position, at least 1.

    Raises:
        ValueError: there is nothing to study."""
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


def title(config: ControllerConfig) -> str:
    """Returns what the picture shows, in one line."""
    line = ", ".join(f"{part:.3g}" for part in config.center_line)
    return f"Workspace of the {config.robot}: center_line [{line}], {config.opening_angle:g} deg"


def sentences(config: ControllerConfig, rig: Rig, study: ReachStudy, tolerances_deg: Sequence[float]) -> list[str]:
    """Returns the settings and the findings, one sentence a line; `tolerances_deg`: yaw, pitch and roll."""
    x, y, z = rig.home.centre
    joints = ", ".join(f"{joint:.1f}" for joint in np.degrees(rig.home.q).round(1) + 0.0)
    different = len(set(tolerances_deg)) > 1
    tolerances = ", ".join(f"+-{value:g}" for value in (tolerances_deg if different else tolerances_deg[:1]))
    home = "home_pos" if config.use_home_pos else "calculated"
    lines = [
        f"The tool may be {config.z_lower_limit:g} to {config.z_upper_limit:g} m high, and "
        f"{config.inner_sphere_limit:g} to {config.outer_sphere_limit:g} m from joint 2; its point is "
        f"{np.linalg.norm(rig.T_flange_tool[:3, 3]):g} m from the flange.",
        f"Its centre is ({x:.3f}, {y:.3f}, {z:.3f}) m.",
        f"The joints at home ({home}): {joints} deg.",
        f"Reached with the tool straight down: {study.percent_down:.1f} % of {len(study.positions)} positions all over "
        "the workspace.",
        f"Reached within yaw, pitch, roll of {tolerances} deg: {study.percent_within:.1f} % of the poses.",
        f"Reached with every orientation that was tried: {study.percent_always:.1f} % of the positions.",
    ]
    if study.failures:
        reasons = (f"{count} {str(reason).split(': ')[-1].rstrip('.')}" for reason, count in study.failures.items())
        lines.append(f"Positions out of reach with the tool straight down: {'; '.join(reasons)}.")
    return lines

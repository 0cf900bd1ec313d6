"""Arms that stand in one world: where each base is, and whether their workspaces keep apart.

A workspace is compared with its hollow filled, since the arm's own links pass there; filled it is convex. Positions in
the frame `world` [m].
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from common.config import is_number, parse_part, vector
from common.errors import ConfigError
from common.frames import PREFIX
from common.mounting import rotation_of_mounting
from common.poses import pose, read_only
from kuka_control.model.workspace import Workspace

LEAST_MARGIN_M = 0.3  # both hands, and what the elbows stick out beyond the tools [m]
MOST_MARGIN_M = 5.0
EXACT_M = 1e-6  # error of a distance, which is never too large [m]
STEPS = 200  # of the search for the nearest points, which needs about ten
LEVEL_RAD = 0.01  # by so much the vertical of `rpy` and that of the parameter mounting may differ

Support = Callable[[np.ndarray], np.ndarray]
"""Of a convex body: a direction, shape (3,), to its farthest point there, shape (3,) [m]."""


@dataclass(frozen=True)
class ArmPlacement:
    """Where the base of an arm stands in the frame `world`."""

    position: np.ndarray = vector(3, "m", low=-10.0, high=10.0, doc="x, y, z of the arm's base in world")
    rpy: np.ndarray = vector(
        3, "deg", low=-180.0, high=180.0, doc="roll, pitch, yaw of the arm's base in world", absent=[0.0, 0.0, 0.0]
    )

    @cached_property
    def T_world_base(self) -> np.ndarray:
        """Pose of the base in world, shape (4, 4) [m]."""
        return read_only(pose(rotation_of_mounting(self.rpy), self.position))


@dataclass(frozen=True)
class Arms:
    """Two arms or more by their names, which are also their namespaces and the prefixes of their frames."""

    margin: float  # between tool points of different arms [m]
    placements: Mapping[str, ArmPlacement]


def arms_from(values: Any, prefix: str = "") -> Arms:
    """Returns what a yaml mapping of `margin` and the arms' names describes; raises ConfigError with all faults.

    `prefix`, such as "arms/", stands before each key in messages.
    """
    if not isinstance(values, Mapping):
        raise ConfigError([f"{prefix or 'The file '}is {values!r}, but must be a mapping: margin, and each arm's name."])
    faults: list[str] = []
    margin = values.get("margin")
    if not is_number(margin) or not LEAST_MARGIN_M <= margin <= MOST_MARGIN_M:
        limits = f"[{LEAST_MARGIN_M:g}, {MOST_MARGIN_M:g}]"
        faults.append(f"{prefix}margin is {margin!r}, but must be a finite number in {limits} m.")
    placements = {}
    for name, entry in values.items():
        if name == "margin":
            continue
        if not isinstance(name, str) or not name or not PREFIX.fullmatch(name):
            faults.append(f"{prefix}{name}: an arm's name must be letters, digits and _, such as left.")
            continue
        placement = parse_part(ArmPlacement, entry, f"{prefix}{name}/", faults)
        if placement is not None:
            placements[name] = placement
    if not faults and len(placements) < 2:
        faults.append(f"{prefix or 'The file '}names {len(placements)} arms, but must name at least two.")
    if faults:
        raise ConfigError(faults)
    return Arms(float(margin), placements)  # type: ignore[arg-type]  # is_number made sure


def placement_faults(arms: Arms, name: str, mounting: np.ndarray, workspaces: Mapping[str, Workspace]) -> list[str]:
    """Returns what keeps the arm `name` from moving beside the others, one sentence each.

    Args:
        arms: all arms.
        name: one of them.
        mounting: its parameter, roll, pitch, yaw [deg].
        workspaces: of all arms.
    """
    own = arms.placements[name]
    faults = []
    vertical = rotation_of_mounting(mounting)[2]
    if math.acos(min(1.0, float(vertical @ own.T_world_base[2, :3]))) > LEVEL_RAD:
        faults.append(
            f"arms/{name}/rpy is {own.rpy.tolist()} deg, but {name}/kuka/mounting is {list(map(float, mounting))} deg, "
            "which has another vertical; give both the same roll and pitch."
        )
    for other, placement in arms.placements.items():
        if other == name:
            continue
        nearest = nearest_points(
            filled(workspaces[name], own.T_world_base), filled(workspaces[other], placement.T_world_base)
        )
        if nearest.distance < arms.margin:
            faults.append(
                f"The workspaces of the arms {name} and {other} are {nearest.distance:.3f} m apart, but arms/margin is "
                f"{arms.margin:g} m; move a base under arms/, or narrow a workspace (opening_angle, center_line, "
                "outer_sphere_limit)."
            )
    return faults


def filled(workspace: Workspace, T_world_base: np.ndarray) -> Support:
    """Returns the workspace without its hollow, as a body in world: out to the base axis, within its other bounds."""
    R, p = T_world_base[:3, :3], T_world_base[:3, 3]
    c, s = math.cos(workspace.heading), math.sin(workspace.heading)
    R = R @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])  # x along center_line
    half, height = workspace.opening_angle / 2.0, workspace.joint_2_height

    def farthest(direction: np.ndarray) -> np.ndarray:
        x, y, dz = (direction @ R).tolist()
        turn = min(max(math.atan2(y, x), -half), half)
        u, v = math.cos(turn), math.sin(turn)
        out = max(u * x + v * y, 0.0)
        length = math.hypot(out, dz)
        z = height + (workspace.outer_sphere * dz / length if length else 0.0)
        z = min(max(z, workspace.z_lower), workspace.z_upper)
        r = workspace.radii(z)[1] if out else 0.0
        return R @ (r * u, r * v, z) + p

    return farthest


class Nearest(NamedTuple):
    """The distance of two convex bodies, and a point of each that is so near, but for EXACT_M."""

    distance: float  # at most the true one; 0 if they overlap [m]
    points: tuple[np.ndarray, np.ndarray]  # shape (3,) each [m]


def nearest_points(first: Support, second: Support) -> Nearest:
    """Returns the distance of two convex bodies, by the algorithm of Gilbert, Johnson and Keerthi (1988)."""
    direction = np.array([1.0, 0.0, 0.0])
    pairs = np.array([[first(direction), second(-direction)]])  # of points of both bodies, shape (n, 2, 3)
    p, q = pairs[0]
    distance = 0.0
    for _ in range(STEPS):
        between = p - q
        length = float(np.linalg.norm(between))
        if length <= EXACT_M:
            return Nearest(0.0, (p, q))
        pair = np.array([first(-between), second(between)])
        # No points of the bodies are nearer than this along `between`, whichever direction that is.
        distance = max(distance, float(between @ (pair[0] - pair[1])) / length)
        if length - distance <= EXACT_M:
            break
        weights, pairs = _nearest_to_origin(np.concatenate([pairs, pair[None]]))
        p, q = np.tensordot(weights, pairs, 1)
    return Nearest(distance, (p, q))


def _nearest_to_origin(pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the convex combination of differences p - q that is nearest to zero: its weights and their pairs."""
    best = math.inf
    found = np.ones(1), pairs[:1]
    for size in range(1, min(len(pairs), 4) + 1):
        for chosen in itertools.combinations(range(len(pairs)), size):
            corners = pairs[list(chosen), 0] - pairs[list(chosen), 1]
            # Least squares of weights whose sum is one.
            others = np.linalg.lstsq((corners[1:] - corners[0]).T, -corners[0], rcond=None)[0]
            weights = np.array([1.0 - others.sum(), *others])
            length = float(np.linalg.norm(weights @ corners))
            if weights.min() >= -1e-12 and length < best:
                best, found = length, (weights, pairs[list(chosen)])
    return found

"""What keeps arms apart that stand in one world: their workspaces, and walls between them for the collision guard. A
workspace is compared with its hollow filled, since the arm's own links pass there; filled it is convex. Positions in
the frame `world` [m]."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Callable, NamedTuple

import numpy as np

from common.arms import Arms
from common.mounting import rotation_of_mounting
from common.poses import inverse, pose, read_only
from kuka_control.model.obstacles import ConvexBody, ConvexShape
from kuka_control.model.workspace import Workspace

EXACT_M = 1e-6  # error of a distance, which is never too large [m]
STEPS = 200  # of the search for the nearest points, which needs about ten
LEAST_APART_M = 0.6  # of two bases: base and link 1, which the guard does not compare with obstacles, are 0.18 m wide
WALL_M, WALL_EDGE_M = 0.04, 5.0  # thickness of the wall between two arms, and its edges, beyond which no arm reaches
SIDE = "side of "  # how the names of the walls begin
LEVEL_RAD = 0.01  # by so much the vertical of `rpy` and that of the parameter mounting may differ

Support = Callable[[np.ndarray], np.ndarray]
"""Of a convex body: a direction, shape (3,), to its farthest point there, shape (3,) [m]."""


def placement_faults(arms: Arms, name: str, mounting: np.ndarray, workspaces: Mapping[str, Workspace]) -> list[str]:
    """Returns what keeps the arm `name` from moving beside the others, one sentence each. `arms`: all arms; `name`:
    one of them; `mounting`: its parameter, roll, pitch, yaw [deg]; `workspaces`: of all arms."""
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
        apart = float(np.linalg.norm(placement.position - own.position))
        if apart < LEAST_APART_M:
            faults.append(
                f"The bases of {name} and {other} are {apart:.3f} m apart under arms/, but must be {LEAST_APART_M:g} m."
            )
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


def walls(arms: Arms, name: str) -> tuple[ConvexBody, ...]:
    """Returns the walls for the collision guard of the arm `name`, in its base: one halfway to each other arm. No part
    of one arm comes nearer to another arm than both margins and WALL_M, whatever either does; what a hand holds is no
    part of it."""
    T_base_world = inverse(arms.placements[name].T_world_base)
    here = arms.placements[name].position
    found = []
    for other, placement in arms.placements.items():
        if other != name:
            x = (placement.position - here) / np.linalg.norm(placement.position - here)
            y = np.cross([0.0, 0.0, 1.0] if abs(x[2]) < 0.9 else [1.0, 0.0, 0.0], x)
            y /= np.linalg.norm(y)
            T_world_wall = pose(np.column_stack([x, y, np.cross(x, y)]), (here + placement.position) / 2.0)
            shape = ConvexShape("box", (WALL_M, WALL_EDGE_M, WALL_EDGE_M))
            found.append(ConvexBody(f"{SIDE}{other}", 0, shape, read_only(T_base_world @ T_world_wall)))
    return tuple(found)


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

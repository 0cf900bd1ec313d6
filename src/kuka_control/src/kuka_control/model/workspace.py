"""The workspace of the tool: a segment of a hollow sphere around the origin of joint 2, cut by planes. A desired
position is constrained in a fixed order: side planes, heights, spheres; the result lists the active bounds. A
position behind the base or below its foot is not constrained: it is infeasible. Positions are in the base frame [m];
rotations play no role."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Sequence

import numpy as np

from common.errors import ConfigError
from common.limits import Limit
from common.poses import read_only


class Infeasibility(str, Enum):
    """Why a position cannot be constrained to the workspace, as a part of a sentence."""

    BEHIND_BASE = "it lies behind the base, as seen along center_line"
    BELOW_BASE = "it lies below the foot of the base"


@dataclass(frozen=True)
class Constrained:
    position: np.ndarray  # shape (3,) [m]; the desired position itself if no bound was active
    bounds: tuple[Limit, ...]  # the active bounds, in the order of their application


@dataclass(frozen=True)
class Infeasible:
    """A position towards which the arm must not move."""

    position: np.ndarray
    reason: Infeasibility

    def __str__(self) -> str:
        x, y, z = self.position
        return f"the position ({x:.3f}, {y:.3f}, {z:.3f}) m is infeasible: {self.reason.value}"


def workspace_faults(
    center_line: np.ndarray | None,
    opening_angle: float | None,
    z_lower: float | None,
    z_upper: float | None,
    inner_sphere: float | None,
    outer_sphere: float | None,
    joint_2_height: float | None,
) -> list[str]:
    """Returns the faults of these settings of a `Workspace`, one sentence each; None: not known, not checked."""
    faults = []
    if center_line is not None:
        faults += _direction_faults(np.asarray(center_line, dtype=float))
    if opening_angle is not None and not 0.0 < opening_angle < math.pi:
        faults.append(f"opening_angle is {math.degrees(opening_angle):g} deg, but must lie between 0 and 180 deg.")
    if z_lower is not None and z_upper is not None and not 0.0 <= z_lower < z_upper < math.inf:
        faults.append(f"z_lower_limit ({z_lower:g} m) must lie between 0 and z_upper_limit ({z_upper:g} m).")
    if inner_sphere is not None and outer_sphere is not None and not 0.0 <= inner_sphere < outer_sphere < math.inf:
        faults.append(
            f"inner_sphere_limit ({inner_sphere:g} m) must lie between 0 and outer_sphere_limit ({outer_sphere:g} m)."
        )
    if faults or z_lower is None or z_upper is None or inner_sphere is None or outer_sphere is None:
        return faults
    if joint_2_height is None:
        return []
    top, foot = joint_2_height + outer_sphere, joint_2_height - outer_sphere
    if z_upper > top:
        faults.append(
            f"z_upper_limit ({z_upper:g} m) is above the top of the outer sphere, which is {top:g} m "
            f"(joint 2 at {joint_2_height:g} m, outer_sphere_limit {outer_sphere:g} m)."
        )
    if z_lower < foot:
        faults.append(f"z_lower_limit ({z_lower:g} m) is below the foot of the outer sphere, which is {foot:g} m.")
    mean_radius, mean_height = (inner_sphere + outer_sphere) / 2.0, (z_lower + z_upper) / 2.0
    if not abs(mean_height - joint_2_height) < mean_radius:
        faults.append(
            f"The workspace has no centre: half way between the z limits ({mean_height:g} m) there is no point at "
            f"{mean_radius:g} m, half way between the spheres, from joint 2 at {joint_2_height:g} m."
        )
    return faults


def _direction_faults(center_line: np.ndarray) -> list[str]:
    if center_line.shape != (3,) or not np.all(np.isfinite(center_line)):
        return [f"center_line is {center_line.tolist()}, but must be three finite numbers."]
    if center_line[2] != 0.0:
        return [f"center_line is {center_line.tolist()}, but its z must be zero: it is horizontal."]
    if not np.any(center_line):
        return ["center_line is the zero vector, which has no direction."]
    return []


@dataclass(frozen=True, eq=False)
class Workspace:
    """The settings of a workspace; constrains positions to it. Raises ConfigError: the settings describe no
    workspace; it lists every fault."""

    center_line: np.ndarray  # horizontal, from the base axis to the middle, shape (3,); its length does not matter
    opening_angle: float  # between the two side planes, which are vertical and contain the base axis [rad]
    z_lower: float  # lowest height [m]
    z_upper: float  # greatest height [m]
    inner_sphere: float  # least distance from the origin of joint 2 [m]
    outer_sphere: float  # greatest distance from the origin of joint 2 [m]
    joint_2_height: float  # height of the origin of joint 2 (RobotModel.base_shoulder) [m]
    lifted: bool = False  # whether its bounds do not act: any position is passed on; centre and home stay

    def __post_init__(self) -> None:
        faults = workspace_faults(**{name: value for name, value in vars(self).items() if name != "lifted"})
        if faults:
            raise ConfigError(faults)
        object.__setattr__(self, "center_line", read_only(self.center_line))

    @cached_property
    def heading(self) -> float:
        """Angle about the base z axis from the x axis to center_line [rad], -pi to pi."""
        return math.atan2(self.center_line[1], self.center_line[0])

    @cached_property
    def centre(self) -> np.ndarray:
        """Half way between the z limits, above center_line, half way between the spheres; shape (3,) [m]."""
        z = (self.z_lower + self.z_upper) / 2.0
        r = _radius_at(z - self.joint_2_height, (self.inner_sphere + self.outer_sphere) / 2.0)
        return read_only([r * math.cos(self.heading), r * math.sin(self.heading), z])

    def radii(self, z: float) -> tuple[float, float]:
        """Returns the least and the greatest distance from the base axis at height z [m]."""
        dz = z - self.joint_2_height
        return _radius_at(dz, self.inner_sphere), _radius_at(dz, self.outer_sphere)

    def contains(self, position: np.ndarray) -> bool:
        """Returns whether the position, shape (3,) [m], lies in the workspace or on its border."""
        result = self.constrain(position)
        return isinstance(result, Constrained) and not result.bounds

    def rooms(self, position: Sequence[float] | np.ndarray) -> tuple[float, ...]:
        """Returns the distances [m] of a position to two side planes, two z limits, two spheres, negative beyond."""
        x, y, z = position
        (a, b, _), (c, d, _) = self._side_normals
        r = math.hypot(x, y, z - self.joint_2_height)
        sides = -(a * x + b * y), -(c * x + d * y)
        return (*sides, z - self.z_lower, self.z_upper - z, r - self.inner_sphere, self.outer_sphere - r)

    def outward(self, position: np.ndarray) -> np.ndarray:
        """Returns the outward unit normals of the bounds, in the order of `rooms`, shape (6, 3). The position, shape
        (3,) [m], is not the origin of joint 2."""
        radial = position - np.array([0.0, 0.0, self.joint_2_height])
        radial /= np.linalg.norm(radial)
        return np.array([*self._side_normals, (0.0, 0.0, -1.0), (0.0, 0.0, 1.0), -radial, radial])

    @cached_property
    def _side_normals(self) -> tuple[tuple[float, float, float], ...]:
        turns = (self.heading + side * (self.opening_angle + math.pi) / 2.0 for side in (1.0, -1.0))
        return tuple((math.cos(turn), math.sin(turn), 0.0) for turn in turns)

    def constrain(self, position: np.ndarray) -> Constrained | Infeasible:
        """Returns the position, shape (3,) [m], constrained to the workspace, or that it is infeasible. Raises
        ValueError: the position is not three finite numbers."""
        # a position beyond a bound by at most this counts as on it [m]; so constraining twice changes nothing
        on_bound = 1e-12
        position = _position(position)
        if self.lifted:
            return Constrained(position, ())
        x, y, z = position.tolist()
        # Along center_line and, horizontally, to its left.
        c, s = math.cos(self.heading), math.sin(self.heading)
        along, left = c * x + s * y, c * y - s * x
        r = math.hypot(along, left)
        if along <= 0.0 or r < on_bound:
            return Infeasible(position, Infeasibility.BEHIND_BASE)
        if z < 0.0:
            return Infeasible(position, Infeasibility.BELOW_BASE)

        bounds = []
        side = math.copysign(self.opening_angle / 2.0, left)
        c_side, s_side = math.cos(side), math.sin(side)
        if abs(left) * c_side - along * abs(s_side) > on_bound:
            bounds.append(Limit.OPENING_ANGLE)
            r = along * c_side + left * s_side
            along, left = r * c_side, r * s_side
        if not self.z_lower <= z <= self.z_upper:
            bounds.append(Limit.Z_LOWER if z < self.z_lower else Limit.Z_UPPER)
            z = min(max(z, self.z_lower), self.z_upper)
        r_inner, r_outer = self.radii(z)
        if not r_inner - on_bound <= r <= r_outer + on_bound:
            bounds.append(Limit.INNER_SPHERE if r < r_inner else Limit.OUTER_SPHERE)
            moved = min(max(r, r_inner), r_outer)
            along, left = along / r * moved, left / r * moved
        if not bounds:
            return Constrained(position, ())
        return Constrained(read_only([c * along - s * left, s * along + c * left, z]), tuple(bounds))


def boundary_lines(workspace: Workspace, heights: int = 5, headings: int = 5) -> list[np.ndarray]:
    """Returns polylines on the border of the workspace for drawing, each of shape (n, 3) [m]. Inner and outer arc
    are drawn at so many `heights`, and so many vertical sections (`headings`) are outlined."""
    half, points = workspace.opening_angle / 2.0, 33
    turns = workspace.heading + np.linspace(-half, half, points)
    lines = []
    for z in np.linspace(workspace.z_lower, workspace.z_upper, heights):
        for r in workspace.radii(z):
            lines.append(np.column_stack([r * np.cos(turns), r * np.sin(turns), np.full(points, z)]))
    z = np.linspace(workspace.z_lower, workspace.z_upper, points)
    radii = np.array([workspace.radii(height) for height in z])
    r = np.concatenate([radii[:, 0], radii[::-1, 1], radii[:1, 0]])
    z = np.concatenate([z, z[::-1], z[:1]])
    for turn in workspace.heading + np.linspace(-half, half, headings):
        lines.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), z]))
    return lines


def _position(position: np.ndarray) -> np.ndarray:
    position = read_only(position)
    if position.shape != (3,) or not all(map(math.isfinite, position.tolist())):
        raise ValueError(f"a position needs three finite numbers, not {position.tolist()}")
    return position


def _radius_at(dz: float, sphere: float) -> float:
    """Returns the distance from the base axis of a sphere's points `dz` above its centre; 0 beyond the sphere."""
    return math.sqrt(max(sphere * sphere - dz * dz, 0.0))

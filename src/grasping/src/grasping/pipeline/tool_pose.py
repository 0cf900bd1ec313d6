"""The hand on the arm: the tool pose that takes a grasp, preferred openings, limits, and whether the arm reaches it.

Frame of a grasp: origin on the surface between the fingers, x through both fingers, z along the approach. A gripper
does not care which of its fingers is on which side, so a grasp allows two orientations half a turn apart.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from common.config import choice, flag, integer, number, vector
from common.poses import pose, translation
from common.rotations import cross, rotation_about, rotation_angle, unit
from grasping.network.maps import HANDS, PARALLEL, Maps

VERTICAL, ALONG_GRASP = "vertical", "grasp"
UP = (0.0, 0.0, 1.0)
STEEP = math.cos(math.radians(80.0))  # fingers whose line rises more steeply than this have no heading
SILENT = "the arm's controller does not answer"
ASKED = "the arm's controller was asked"
RETRY_S = 1.0  # an unanswered request is repeated after this time


@dataclass(frozen=True)
class ToolPoseConfig:
    """The schema of tool_pose.yaml."""

    hand: str = choice(*HANDS, absent=PARALLEL, doc="which hand it is; weights for another one are warned about")
    grip_in_tool: np.ndarray = vector(3, "m", low=-0.5, high=0.5, doc="where the grasp's origin is in the tool's frame")
    closing_angle: float = number(
        "deg", low=-180.0, high=180.0, doc="from the tool's x axis, about its z axis, to the line the fingers close on"
    )
    approach: str = choice(
        VERTICAL,
        ALONG_GRASP,
        doc="vertical: the tool points down; grasp: along the grasp's z axis, as always if a network of lifts chose it",
    )
    clearance: float = number("m", low=0.0, high=0.5, doc="how far the tool stops before the grasp")
    max_opening: float = number("m", above=0.0, high=0.5, doc="widest thing that the open hand takes")
    preferred_opening: np.ndarray = vector(
        2, "m", low=0.0, high=0.5, absent=(0.0, 0.5), doc="least and largest opening that the hand holds best"
    )
    outside_quality: float = number(
        above=0.0,
        high=1.0,
        absent=1.0,
        doc="fraction of the quality above peaks/threshold that is left for other openings; 1 = no preference",
    )
    outside_ramp: float = number(
        "m", above=0.0, high=0.1, absent=0.01, doc="change of the opening over which the fraction falls to that"
    )

    def faults(self) -> list[str]:
        low, high = self.preferred_opening
        if low < high:
            return []
        return [f"preferred_opening is [{low:g}, {high:g}], but the least must be below the largest."]


def tool_pose(T_base_grasp: np.ndarray, settings: ToolPoseConfig, near: np.ndarray, up: ArrayLike = UP) -> np.ndarray:
    """Returns T_base_tool, shape (4, 4) [m], of the tool that takes T_base_grasp, shape (4, 4) [m]: of two orientations
    the nearer to `near`, R_base_tool, shape (3, 3). `up` is the vertical in the base frame, shape (3,). Raises
    ValueError if the approach is vertical, and so is the line through the fingers.
    """
    z = -unit(up) if settings.approach == VERTICAL else T_base_grasp[:3, 2]
    fingers = T_base_grasp[:3, 0]
    across = fingers - (fingers @ z) * z
    if np.linalg.norm(across) < STEEP:
        raise ValueError(f"the line through the fingers, {fingers.tolist()}, lies along the approach")
    x = unit(across)
    R = np.column_stack([x, cross(z, x), z]) @ rotation_about(2, -math.radians(settings.closing_angle))
    R = min((R, R @ rotation_about(2, math.pi)), key=lambda R_base_tool: rotation_angle(near.T @ R_base_tool))
    return pose(R, T_base_grasp[:3, 3] - R @ settings.grip_in_tool)


def taken(settings: ToolPoseConfig, own_approach: bool) -> ToolPoseConfig:
    """Returns how the hand takes a grasp, which may have an approach of its own, whatever the settings say."""
    return replace(settings, approach=ALONG_GRASP) if own_approach else settings


def grasp_in_tool(settings: ToolPoseConfig) -> np.ndarray:
    """Returns T_tool_grasp, shape (4, 4) [m], of the hand on the tool: x through its fingers."""
    return pose(rotation_about(2, math.radians(settings.closing_angle)), settings.grip_in_tool)


def above(T_base_tool: np.ndarray, clearance: float) -> np.ndarray:
    """Returns the pose of a tool or grasp so far before it, against its z axis: above it where it points down [m]."""
    return T_base_tool @ translation(0.0, 0.0, -clearance)


def preferred(maps: Maps, pixel_m: np.ndarray, tool: ToolPoseConfig, threshold: float) -> Maps:
    """Returns the maps with the quality that they have for a hand; it is nowhere higher than before. `pixel_m`: what a
    pixel shows of the scene, shape (h, w) [m]; `threshold`: of the quality; what is not above it stays as it is.
    """
    if tool.outside_quality == 1.0:
        return maps
    above = np.nonzero(maps.quality > threshold)
    found = maps.quality[above]
    opening = np.broadcast_to(pixel_m, maps.quality.shape)[above] * np.maximum(maps.width[above], 0.0)
    low, high = tool.preferred_opening
    outside = np.maximum(low - opening, opening - high) / tool.outside_ramp
    left = 1.0 - (1.0 - tool.outside_quality) * np.clip(outside, 0.0, 1.0)
    shrunk = np.minimum(found, threshold + left * (found - threshold))
    quality = maps.quality.copy()
    quality[above] = np.where(left < 1.0, shrunk, found)
    return maps._replace(quality=quality)


@dataclass(frozen=True)
class LimitsConfig:
    """Limits of a grasp."""

    nearest: float = number("m", low=0.0, high=10.0, doc="least depth of a grasp before the camera")
    farthest: float = number("m", above=0.0, high=10.0, doc="largest depth")
    x: np.ndarray = vector(2, "m", low=-5.0, high=5.0, doc="least and largest x in kuka/base_frame")
    y: np.ndarray = vector(2, "m", low=-5.0, high=5.0, doc="least and largest y")
    z: np.ndarray = vector(2, "m", low=-5.0, high=5.0, doc="least and largest z")

    def faults(self) -> list[str]:
        faults = [
            f"{name} is {list(getattr(self, name))}, but the least must be below the largest."
            for name in "xyz"
            if getattr(self, name)[0] >= getattr(self, name)[1]
        ]
        if self.nearest >= self.farthest:
            faults.append(f"nearest is {self.nearest:g} m, but must be below farthest, {self.farthest:g} m.")
        return faults


def rejection_reason(
    T_camera_grasp: np.ndarray, T_base_grasp: np.ndarray | None, width: float, opening: float, limits: LimitsConfig
) -> str:
    """Returns why a grasp is rejected, a clause about the grasp; empty if it is accepted. Poses: shape (4, 4) [m], the
    one in kuka/base_frame unchecked if None. `width`: opening that the grasp needs; `opening`: widest of the hand [m].
    """
    depth = T_camera_grasp[2, 3]
    if not limits.nearest <= depth <= limits.farthest:
        allowed = f"{limits.nearest:.2f} to {limits.farthest:.2f} m"
        return f"it is {depth:.2f} m before the camera, and {allowed} are allowed"
    if width > opening:
        return f"it needs an opening of {1e3 * width:.0f} mm, and the hand has {1e3 * opening:.0f} mm"
    if T_base_grasp is None:
        return ""
    return _outside(T_base_grasp[:3, 3], limits)


def _outside(place: np.ndarray, limits: LimitsConfig) -> str:
    for name, value in zip("xyz", place):
        low, high = getattr(limits, name)
        if not low <= value <= high:
            return f"its {name} is {value:.2f} m in the base frame, and {low:.2f} to {high:.2f} m are allowed"
    return ""


def wait_rejection_reason(T_base_grasp: np.ndarray, clearance: float, up: np.ndarray, limits: LimitsConfig) -> str:
    """Returns why the hand cannot wait `clearance` [m] before a grasp, shape (4, 4) [m], a clause; empty if it can.
    `up` is the vertical in the base frame, shape (3,)."""
    before = above(T_base_grasp, clearance)[:3, 3]
    if clearance > 0.0 and (before - T_base_grasp[:3, 3]) @ up <= 0.0:
        return "the hand would wait lower than it"
    why = _outside(before, limits)
    return f"where the hand would wait for it, {why}" if why else ""


@dataclass(frozen=True)
class ReachConfig:
    """How the controller is queried."""

    ask: bool = flag(doc="ask the arm's controller; false: every grasp within the limits counts as reachable")
    best: int = integer(low=1, high=20, doc="number of best grasps that the controller is asked about")
    timeout: float = number("s", above=0.0, high=60.0, doc="without an answer for this long it counts as silent")
    keep: float = number("s", above=0.0, high=600.0, doc="an answer expires after this long")
    same_distance: float = number("m", above=0.0, high=0.1, doc="an answer holds for grasps this near, and")
    same_angle: float = number("deg", above=0.0, high=45.0, doc="turned by no more than this")


class Reachability(NamedTuple):
    """Whether the arm reaches a tool pose."""

    reachable: bool  # whether the arm gets there; False while that is unknown
    reason: str  # why not, or why it is unknown; empty if it does
    refused: bool = False  # whether the controller said no


class _Entry(NamedTuple):
    T: np.ndarray
    asked: float
    answer: Reachability | None


class ReachabilityCache:
    """Keeps the answers by the number of the grasp; the client queries the controller."""

    def __init__(self, config: ReachConfig) -> None:
        self._config = config
        self._entries: dict[int, _Entry] = {}

    def wanted(self, number: int, T_base_grasp: np.ndarray, now: float) -> bool:
        """Returns whether the controller must be asked about a grasp, shape (4, 4) [m]."""
        entry = self._entries.get(number)
        if entry is None or not self._same(entry.T, T_base_grasp):
            return True
        return now - entry.asked > (RETRY_S if entry.answer is None else self._config.keep)

    def asked(self, number: int, T_base_grasp: np.ndarray, now: float) -> None:
        """Notes a request; the earlier answer about this pose holds until the new one."""
        before = self._entries.get(number)
        kept = before.answer if before is not None and self._same(before.T, T_base_grasp) else None
        self._entries[number] = _Entry(T_base_grasp, now, kept)

    def answered(self, number: int, answer: Reachability | None) -> None:
        """Notes the answer to the latest request about a grasp; None: there was none."""
        if number in self._entries:
            self._entries[number] = self._entries[number]._replace(answer=answer)

    def known(self, number: int) -> Reachability | None:
        """Returns the answer about a grasp; None before it came."""
        entry = self._entries.get(number)
        return None if entry is None else entry.answer

    def keep_only(self, numbers: Collection[int]) -> None:
        """Forgets the other grasps."""
        self._entries = {n: e for n, e in self._entries.items() if n in numbers}

    def _same(self, a: np.ndarray, b: np.ndarray) -> bool:
        c = self._config
        near = np.linalg.norm(a[:3, 3] - b[:3, 3]) <= c.same_distance
        return bool(near and np.degrees(rotation_angle(a[:3, :3].T @ b[:3, :3])) <= c.same_angle)

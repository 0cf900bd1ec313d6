"""The home position: the tool in the workspace centre, its z axis down, the arm upright in the plane of center_line.

In that plane the chain has three joints, 2, 4 and 6, and the elbow above them; joints 3, 5 and 7 are zero. For a
center_line with x >= 0 joint 1 turns the plane towards it and the tool's x axis points back to the base; else joint 1
turns the opposite direction there, the arm leans over backwards (the signs of joints 2, 4, 6 change), and the tool's
x axis points along center_line. So joint 1 never turns further than a quarter. Base frame, metres, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.errors import RigError
from common.poses import read_only, translation
from kuka_control.kinematics import forward
from kuka_control.robot_model import RobotModel
from kuka_control.workspace import Infeasible, Workspace


class HomeError(RigError):
    """There is no home position with these settings."""


@dataclass(frozen=True, eq=False)
class Home:
    """Where the arm waits.

    Attributes:
        q: joints, shape (7,) [rad].
        T_base_tool: pose of the tool, shape (4, 4) [m].
        T_base_flange: pose of the flange, shape (4, 4) [m].
        centre: workspace centre, about which motions are scaled, shape (3,) [m].
    """

    q: np.ndarray
    T_base_tool: np.ndarray
    T_base_flange: np.ndarray
    centre: np.ndarray


def home_pose(model: RobotModel, workspace: Workspace, tool_length: float) -> Home:
    """Returns the home position above the workspace's center_line.

    Args:
        model: the arm.
        workspace: of the tool.
        tool_length: from the flange to the tool point, along the flange's z axis [m].

    Raises:
        HomeError: the workspace centre is out of reach or a joint would be out of its range.
    """
    x, y, z = workspace.centre.tolist()
    out = math.hypot(x, y)
    up = z + tool_length + model.wrist_flange - model.base_shoulder
    reach = math.hypot(out, up)
    upper_arm, forearm = model.shoulder_elbow, model.elbow_wrist
    if not abs(upper_arm - forearm) < reach <= upper_arm + forearm:
        raise HomeError(
            f"The home position is out of reach: with a tool of {tool_length:g} m that points down to the workspace "
            f"centre at {z:.3f} m, {out:.3f} m from the base axis, the wrist would be {reach:.3f} m from the shoulder, "
            f"and the arm reaches {upper_arm + forearm:g} m; {_cause(up, tool_length)}."
        )
    bend = math.acos((reach * reach - upper_arm**2 - forearm**2) / (2.0 * upper_arm * forearm))
    lift = math.atan2(forearm * math.sin(bend), upper_arm + forearm * math.cos(bend))
    lean = math.atan2(out, up) - lift
    sign = 1.0 if workspace.center_line[0] >= 0.0 else -1.0
    q = np.array([math.atan2(sign * y, sign * x), sign * lean, 0.0, -sign * bend, 0.0, 0.0, 0.0])
    q[5] = sign * (math.pi - lean - bend)
    outside = _out_of_range(model, q)
    if outside:
        raise HomeError(
            f"The home position at the workspace centre, with a tool of {tool_length:g} m, needs {outside}; "
            f"{_cause(up, tool_length)}."
        )
    return _home(model, q, tool_length, workspace.centre)


def custom_home(model: RobotModel, workspace: Workspace, tool_length: float, q: np.ndarray) -> Home:
    """Returns the home position with the joints `q`, shape (7,) [rad]; the tool point there becomes the centre.

    Raises:
        HomeError: a joint is out of its range, or the tool point lies outside the workspace.
    """
    q = np.asarray(q, dtype=float)
    if q.shape != (7,) or not np.all(np.isfinite(q)):
        raise HomeError(f"home_pos needs seven finite numbers, not {q.tolist()}.")
    outside = _out_of_range(model, q)
    if outside:
        raise HomeError(f"home_pos has {outside}.")
    home = _home(model, q, tool_length, None)
    result = workspace.constrain(home.centre)
    if isinstance(result, Infeasible):
        raise HomeError(f"home_pos brings the tool point out of the workspace: {result}.")
    if result.bounds:
        raise HomeError(
            f"home_pos brings the tool point to ({', '.join(f'{c:.3f}' for c in home.centre)}) m, which is outside the "
            f"workspace ({', '.join(map(str, result.bounds))}); change home_pos, the limits, or tool_length "
            f"({tool_length:g} m)."
        )
    return home


def _home(model: RobotModel, q: np.ndarray, tool_length: float, centre: np.ndarray | None) -> Home:
    T_base_flange = forward(model, q)
    T_base_tool = T_base_flange @ translation(0.0, 0.0, tool_length)
    return Home(
        q=read_only(q),
        T_base_tool=read_only(T_base_tool),
        T_base_flange=read_only(T_base_flange),
        centre=read_only(T_base_tool[:3, 3] if centre is None else centre),
    )


def _out_of_range(model: RobotModel, q: np.ndarray) -> str:
    """Returns which joints are out of range, as a part of a sentence; empty if none is."""
    return " and ".join(
        f"joint {i + 1} at {math.degrees(a):.1f} deg (range {math.degrees(low):.0f} to {math.degrees(high):.0f} deg)"
        for i, (a, low, high) in enumerate(zip(q, model.lower, model.upper))
        if not low <= a <= high
    )


def _cause(up: float, tool_length: float) -> str:
    """Returns what is probably wrong, as a part of a sentence; `up` is the height of wrist over shoulder [m]."""
    if tool_length > 0.0 and up > 0.0:
        return "probably the tool is too long, or the workspace is too high or too wide"
    return "probably the workspace is too wide or too low"

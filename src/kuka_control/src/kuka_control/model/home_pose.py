"""The home position: the tool in the workspace centre, its z axis down, upper arm and forearm in one upright plane.

Joint 3 is zero and the elbow is above the line from shoulder to wrist. For a center_line with x >= 0, joint 1 turns the
plane towards it and the tool's x axis points back to the base; otherwise the arm leans over backwards (joints 2, 4 and
6 change sign), and the tool's x axis points along center_line. So joint 1 never turns by more than 90 deg. Joints 5 and
7 turn as little as the orientation of the tool asks for. "Down" is that of the world (see common.mounting); the plane
contains the base's z axis. A calibrated arm has the same tool pose, but other joints. Base frame, metres, radians."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.errors import RigError
from common.mounting import MountingFrame, mounting_frame
from common.poses import inverse, pose, read_only
from common.rotations import rotation_about
from iiwa_kinematics import Kinematics
from iiwa_kinematics.robot_model import RobotModel
from kuka_control.model.workspace import Infeasible, Workspace

ROUNDING_RAD = 1e-12  # a joint closer to zero than this counts as zero


class HomeError(RigError):
    """These settings have no home position."""


@dataclass(frozen=True, eq=False)
class Home:
    """The home position: joints, shape (7,) [rad], and poses of tool and flange, shape (4, 4) [m]."""

    q: np.ndarray
    T_base_tool: np.ndarray
    T_base_flange: np.ndarray
    centre: np.ndarray  # workspace centre, about which motions are scaled, shape (3,) [m]


def home_pose(kinematics: Kinematics, workspace: Workspace, mounting: MountingFrame | None = None) -> Home:
    """Returns the home position above the workspace's center_line. `mounting` are the operator's directions; None:
    the arm stands upright. Raises HomeError: the workspace centre is out of reach or a joint would be out of its
    range."""
    mounting = mounting_frame(workspace.center_line) if mounting is None else mounting
    model, T_flange_tool = kinematics.model, kinematics.T_flange_tool
    T_base_tool = pose(mounting.R_base_tool, workspace.centre)
    T_base_flange = T_base_tool @ inverse(T_flange_tool)
    wrist = T_base_flange[:3, 3] - model.wrist_flange * T_base_flange[:3, 2]
    side = -1.0 if wrist[:2] @ workspace.center_line[:2] < 0.0 else 1.0  # a wrist behind the base axis counts as -out
    out, up = side * math.hypot(wrist[0], wrist[1]), wrist[2] - model.base_shoulder
    reach = math.hypot(out, up)
    upper_arm, forearm = model.shoulder_elbow, model.elbow_wrist
    cause = _cause(up, T_flange_tool, mounting)
    if not abs(upper_arm - forearm) < reach <= upper_arm + forearm:
        raise HomeError(
            f"The home position is out of reach: with {_tool(T_flange_tool)} that points down to the workspace "
            f"centre at {workspace.centre[2]:.3f} m, {math.hypot(*workspace.centre[:2]):.3f} m from the base axis, the "
            f"wrist would be {reach:.3f} m from the shoulder, and the arm reaches {upper_arm + forearm:g} m; {cause}."
        )
    bend = math.acos((reach * reach - upper_arm**2 - forearm**2) / (2.0 * upper_arm * forearm))
    lift = math.atan2(forearm * math.sin(bend), upper_arm + forearm * math.cos(bend))
    lean = math.atan2(out, up) - lift
    sign = 1.0 if workspace.center_line[0] >= 0.0 else -1.0
    turn = math.atan2(side * sign * wrist[1], side * sign * wrist[0])
    R_forearm_flange = rotation_about(1, -sign * (lean + bend)) @ rotation_about(2, -turn) @ T_base_flange[:3, :3]
    q = np.array([turn, sign * lean, 0.0, -sign * bend, *_wrist_joints(model, R_forearm_flange)])
    q[np.abs(q) < ROUNDING_RAD] = 0.0
    outside = _out_of_range(model, q)
    if outside:
        raise HomeError(
            f"The home position at the workspace centre, with {_tool(T_flange_tool)}, needs {outside}; {cause}."
        )
    refined = kinematics.refined(q, T_base_tool)
    if refined is None:
        raise HomeError(f"The calibrated arm does not reach the home position at the workspace centre; {cause}.")
    return _home(kinematics, refined, workspace.centre)


def custom_home(kinematics: Kinematics, workspace: Workspace, q: np.ndarray) -> Home:
    """Returns the home position with the joints `q`, shape (7,) [rad]; the tool point there becomes the centre.
    Raises HomeError: a joint is out of its range, or the tool point lies outside the workspace."""
    q = np.asarray(q, dtype=float)
    if q.shape != (7,) or not np.all(np.isfinite(q)):
        raise HomeError(f"home_pos needs seven finite numbers, not {q.tolist()}.")
    outside = _out_of_range(kinematics.model, q)
    if outside:
        raise HomeError(f"home_pos has {outside}.")
    home = _home(kinematics, q, None)
    result = workspace.constrain(home.centre)
    if isinstance(result, Infeasible):
        raise HomeError(f"home_pos brings the tool point out of the workspace: {result}.")
    if result.bounds:
        raise HomeError(
            f"home_pos brings the tool point to ({', '.join(f'{c:.3f}' for c in home.centre)}) m, which is outside the "
            f"workspace ({', '.join(map(str, result.bounds))}); change home_pos, the limits, or the tool "
            f"({_tool(kinematics.T_flange_tool)})."
        )
    return home


def _home(kinematics: Kinematics, q: np.ndarray, centre: np.ndarray | None) -> Home:
    T_base_tool = kinematics.forward(q)
    T_base_flange = T_base_tool @ inverse(kinematics.T_flange_tool)
    return Home(
        q=read_only(q),
        T_base_tool=read_only(T_base_tool),
        T_base_flange=read_only(T_base_flange),
        centre=read_only(T_base_tool[:3, 3] if centre is None else centre),
    )


def _wrist_joints(model: RobotModel, R_forearm_flange: np.ndarray) -> tuple[float, float, float]:
    """Returns joints 5, 6, 7 [rad] for this rotation: of the two solutions the one in range, then the smaller one."""
    R = R_forearm_flange
    across = math.hypot(R[0, 2], R[1, 2])
    if across < ROUNDING_RAD:  # the flange points along the forearm: joints 5 and 7 turn about one line
        return 0.0, math.atan2(across, R[2, 2]), math.atan2(R[1, 0], R[0, 0]) if R[2, 2] > 0.0 else 0.0
    solutions = []
    for sign in (1.0, -1.0):
        q5 = math.atan2(sign * R[1, 2], sign * R[0, 2])
        q7 = math.atan2(sign * R[2, 1], -sign * R[2, 0])
        q = (q5, math.atan2(sign * across, R[2, 2]), q7)
        solutions.append((bool(np.any(np.abs(q) > model.upper[4:])), q5 * q5 + q7 * q7, q))
    return min(solutions)[2]


def _out_of_range(model: RobotModel, q: np.ndarray) -> str:
    """Returns which joints are out of range, as a part of a sentence; empty if none is."""
    return " and ".join(
        f"joint {i + 1} at {math.degrees(a):.1f} deg (range {math.degrees(low):.0f} to {math.degrees(high):.0f} deg)"
        for i, (a, low, high) in enumerate(zip(q, model.lower, model.upper))
        if not low <= a <= high
    )


def _tool(T_flange_tool: np.ndarray) -> str:
    return f"a tool of {np.linalg.norm(T_flange_tool[:3, 3]):g} m"


def _cause(up: float, T_flange_tool: np.ndarray, mounting: MountingFrame) -> str:
    """Returns the probable cause, as a part of a sentence; `up` is the height of the wrist above the shoulder [m]."""
    # An arm counts as upright if the cosine of the angle between its z axis and the vertical exceeds this.
    upright_cosine = 1.0 - 1e-6
    if mounting.up[2] < upright_cosine:
        return (
            "an arm that is not mounted upright needs a workspace of its own: on a ceiling far from the base, "
            "on a wall with center_line down or sideways"
        )
    if np.abs(T_flange_tool[:3, :3] - np.eye(3)).max() > ROUNDING_RAD:
        return "probably tool_transform turns the tool too far, or the tool is too long"
    if np.any(T_flange_tool[:3, 3]) and up > 0.0:
        return "probably the tool is too long, or the workspace is too high or too wide"
    return "probably the workspace is too wide or too low"

"""Motions for programs: the goal, the checks before a motion starts, and its progress."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from common.modes import Mode
from common.poses import read_only
from iiwa_kinematics import Kinematics, arm_points
from kuka_control.limits.line_plan import LineLimits, LinePlan, MoveRefused, plan_line
from kuka_control.loop.transitions import TRANSITIONS, Trigger
from kuka_control.model.desired_frame import rejection_reason
from kuka_control.model.joint_configurations import range_faults
from kuka_control.model.rig import Rig
from kuka_control.model.target import MotionScaling, check_tool_pose
from kuka_control.numbers import LEAST_LINE_M_PER_S, LEAST_PTP

READY = frozenset(state.mode for row in TRANSITIONS if row.trigger is Trigger.MOVE for state in row.sources)
"""The modes in which a motion may start."""


@dataclass(frozen=True)
class MoveGoal:
    target: np.ndarray | str  # joints, shape (7,) [rad], a tool pose, shape (4, 4) [m], or a name
    straight: bool = False  # whether the tool is to move along a straight line
    velocity: float = 0.0  # fraction of the full joint speed, (0, 1], of a line [m/s]; 0: the usual one


@dataclass(frozen=True)
class ProgramMotion:
    """A motion that is checked and may start; a later one has a greater number."""

    number: int
    name: str  # where to, in words
    q: np.ndarray  # joints at the goal, shape (7,) [rad]
    velocity: float  # fraction of the full joint speed; of a line [m/s]
    line: LinePlan | None = None
    cancelled: bool = False
    guided: bool = False  # a hand moves the arm, and it has no goal


class MoveState(Enum):
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "cancelled"
    REFUSED = "refused"
    ABORTED = "aborted"


@dataclass(frozen=True)
class MoveProgress:
    number: int
    state: MoveState
    sentence: str = ""  # about its end
    fraction: float = 0.0  # that is done, 0 to 1
    left: float = 0.0  # of a line [m], else of the farthest joint [rad]


class MovePlanner:
    """Checks what programs ask for. It has no state, so any thread may ask it. `named`: joints by name, shape (7,)
    [rad], home and zero are known besides; `usual`, `greatest`: velocities of PTP motions, fractions of the full joint
    speed; `line`: the limits of straight lines, None if this controller makes none."""

    def __init__(
        self, rig: Rig, named: Mapping[str, np.ndarray], usual: float, greatest: float, line: LineLimits | None
    ) -> None:
        self._rig = rig
        self._named = {"zero": read_only(np.zeros(7)), **named, "home": rig.home.q}
        self._usual = usual
        self._greatest = greatest
        self._line = line

    def plan(self, number: int, goal: MoveGoal, q: np.ndarray) -> ProgramMotion:
        """Returns the motion from the joints q of the arm, shape (7,) [rad]; MoveRefused says why there is none."""
        target = goal.target
        if goal.straight:
            if isinstance(target, str) or target.shape != (4, 4):
                raise MoveRefused("A straight line goes to a pose, not to joints or a name.")
            return self._along_a_line(number, target, goal.velocity, q)
        velocity = _velocity(goal.velocity, self._usual, LEAST_PTP, self._greatest, "of the full joint speed")
        if isinstance(target, str):
            if target not in self._named:
                raise MoveRefused(f"There is no position {target!r}; known are {', '.join(sorted(self._named))}.")
            name, q_goal = target, self._named[target]
        elif target.shape == (4, 4):
            name, q_goal = "the pose", self._joints_of(target, q)
        else:
            name, q_goal = "the joints", self._checked_joints(target)
        self._check_heights(q, q_goal)
        return ProgramMotion(number, name, read_only(q_goal), velocity)

    def _along_a_line(self, number: int, T_goal: np.ndarray, velocity: float, q: np.ndarray) -> ProgramMotion:
        if self._line is None:
            raise MoveRefused("Straight lines need the real-time controller with shaping: ruckig.")
        fastest = self._line.speed
        usual = 0.1  # where the program names no speed [m/s]
        speed = _velocity(velocity, min(usual, fastest), LEAST_LINE_M_PER_S, fastest, "m/s")
        _check_pose(T_goal)
        line = plan_line(self._line, q, T_goal, speed)
        return ProgramMotion(number, "the pose", line.q_goal, speed, line)

    def _joints_of(self, T_base_tool: np.ndarray, q: np.ndarray) -> np.ndarray:
        _check_pose(T_base_tool)
        check = check_tool_pose(self._rig.chain, T_base_tool, MotionScaling(), q)
        if check.q is None:
            raise MoveRefused(check.sentence)
        return check.q

    def _checked_joints(self, q: np.ndarray) -> np.ndarray:
        if q.shape != (7,) or not all(map(math.isfinite, q.tolist())):
            raise MoveRefused(f"The joints are {q.tolist()}, but must be seven finite angles in rad.")
        faults = range_faults(self._rig.model, q)
        if faults:
            raise MoveRefused(faults[0])
        return q

    def _check_heights(self, q: np.ndarray, q_goal: np.ndarray) -> None:
        """Refuses a way on which the tool point, or the elbow or the wrist, comes below the workspace."""
        kinematics = self._rig.kinematics
        step = 0.05  # of the joints from one check to the next [rad]
        low = 1e-3  # by which the tool point may come below the workspace [m]
        least = self._rig.workspace.z_lower - low
        steps = int(np.max(np.abs(q_goal - q)) / step) + 2
        for s in np.linspace(0.0, 1.0, steps):
            height, what = _lowest(kinematics, q + s * (q_goal - q))
            if height < least:
                raise MoveRefused(
                    f"At {100.0 * s:.0f} % of the motion the {what} would be at a height of {height:.3f} m, below "
                    f"z_lower_limit ({least + low:g} m)."
                )


def wrong_time(mode: Mode, reason: str, guided: bool) -> str:
    """Returns why no motion for a program, or `guided` by a hand, can start in a mode that has this reason, two
    sentences."""
    who = mover(guided)
    return f"{who.capitalize()} the arm at home or where a program moved it, but the mode is {mode.value}. {reason}"


def mover(guided: bool) -> str:
    """Returns who may do what with the arm, the begin of a part of a sentence."""
    return "a hand may guide" if guided else "a program may move"


def _lowest(kinematics: Kinematics, q: np.ndarray) -> tuple[float, str]:
    """Returns the height in the base frame of what is lowest of tool point, elbow and wrist [m], and its name."""
    _, _, elbow, wrist, _ = arm_points(kinematics.model, q)
    tool = kinematics.tool_point(q.tolist())[0]
    return min((float(tool[2]), "tool point"), (float(elbow[2]), "elbow"), (float(wrist[2]), "wrist"))


def _velocity(asked: float, usual: float, least: float, greatest: float, unit: str) -> float:
    if asked == 0.0:
        return usual
    least = min(least, greatest)
    if not least <= asked <= greatest:
        raise MoveRefused(f"The velocity is {asked:g}, but must be at least {least:g} and at most {greatest:g} {unit}.")
    return asked


def _check_pose(T_base_tool: np.ndarray) -> None:
    reason = rejection_reason(T_base_tool)
    if reason is not None:
        raise MoveRefused(f"The tool pose is refused: {reason}")

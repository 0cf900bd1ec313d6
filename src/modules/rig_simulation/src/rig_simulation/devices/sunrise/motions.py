"""The motions of the main thread's commands, planned from the present position of the arm.

Each planner returns the motion, or None if the arm is at its target already.
"""

from __future__ import annotations

from typing import Callable

import numpy as np

from rig_simulation.devices.sunrise.arm import SimulatedArm
from rig_simulation.devices.sunrise.goals import MM_PER_M, Goals, pose_from_frame
from rig_simulation.devices.sunrise.paths import Circle, Line, Unreachable, plan, shifted
from rig_simulation.devices.sunrise.profiles import JointMove, PathMove

ARRIVED_JOINT_RAD = np.radians(0.1)
ARRIVED_TOOL_M = 2e-4


def joint_motion(arm: SimulatedArm, goals: Goals) -> JointMove | None:
    """Plans the joint motion to the goal at the relative speed.

    Raises:
        Unreachable: the speed is not in (0, 1], or the goal is outside the joint range.
    """
    if not 0.0 < goals.speed <= 1.0 or not arm.robot.within_range(goals.joints):
        raise Unreachable(f"the speed {goals.speed} or the goal {goals.joints.tolist()} is out of range")
    if np.array_equal(arm.q, goals.joints):
        return None
    return JointMove(arm.q, goals.joints, goals.speed * arm.robot.max_speed, arm.motion_acceleration)


def line(arm: SimulatedArm, goals: Goals) -> PathMove | None:
    """Plans a line of the tool to the target pose.

    Raises:
        Unreachable: see `paths.plan`.
    """
    return _follow(arm, goals, Line(arm.tool, pose_from_frame(goals.target)))


def relative_line(arm: SimulatedArm, goals: Goals, along_tool: bool) -> PathMove | None:
    """Plans a line by the target's X, Y, Z along the axes of the tool or of the base.

    Raises:
        Unreachable: see `paths.plan`.
    """
    return _follow(arm, goals, Line(arm.tool, shifted(arm.tool, goals.target[:3] / MM_PER_M, along_tool)))


def circle(arm: SimulatedArm, goals: Goals) -> PathMove | None:
    """Plans the arc of the tool through the via pose to the end pose.

    Raises:
        Unreachable: the three positions are collinear, or see `paths.plan`.
    """
    return _follow(arm, goals, Circle(arm.tool, pose_from_frame(goals.via), pose_from_frame(goals.end)))


def leaves_torque_ranges(ranges: np.ndarray) -> Callable[[SimulatedArm], bool]:
    """Returns the condition that interrupts a guarded motion.

    Args:
        ranges: rows of joint index from 0, lowest, highest external torque, shape (n, 3) [Nm].

    Raises:
        ValueError: there is no such joint.
    """
    joints, low, high = ranges[:, 0].astype(int), ranges[:, 1], ranges[:, 2]
    if np.any((joints < 0) | (joints > 6)):
        raise ValueError(f"the joint indices {joints.tolist()} are not all 0 to 6")

    def condition(arm: SimulatedArm) -> bool:
        torque = arm.external_torques[joints]
        return bool(np.any((torque < low) | (torque > high)))

    return condition


def arrived_at_joints(arm: SimulatedArm, q: np.ndarray) -> bool:
    """Returns whether a guarded joint motion has arrived at the angles q, shape (7,) [rad]."""
    return bool(np.max(np.abs(arm.q - q)) <= ARRIVED_JOINT_RAD)


def arrived_at_pose(arm: SimulatedArm, T_base_tool: np.ndarray) -> bool:
    """Returns whether a guarded line has arrived at the pose, shape (4, 4)."""
    return bool(np.max(np.abs((arm.tool - T_base_tool)[:3, 3])) <= ARRIVED_TOOL_M)


def _follow(arm: SimulatedArm, goals: Goals, path: Line | Circle) -> PathMove | None:
    return plan(path, goals.speed / MM_PER_M, arm.robot, arm.T_flange_tool, arm.q, arm.motion_acceleration)

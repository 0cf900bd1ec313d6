"""A motion from joints to joints before it starts: its steps, duration and tool speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from iiwa_kinematics import jacobian
from iiwa_kinematics.robot_model import RobotModel
from kst import PtpLimits

STEPS = 101
"""Number of points of the path at which the speed of the tool is calculated."""

ARRIVED_DEG = float(np.degrees(PtpLimits.arrived))
"""The arm is at a configuration if no joint is further from it than this [deg]."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """A motion from the joints `start` to the joints `target`, shape (7,) each [rad]."""

    start: np.ndarray
    target: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_only(self.start))
        object.__setattr__(self, "target", read_only(self.target))

    @property
    def largest(self) -> tuple[int, float]:
        """The joint that turns furthest, 1 to 7, and by how much [deg], with its sign."""
        return _largest(self.target - self.start)

    @property
    def needed(self) -> bool:
        """Whether the arm is anywhere else than at the target."""
        return abs(self.largest[1]) > ARRIVED_DEG

    def greatest_tool_speed(self, model: RobotModel, T_flange_tool: np.ndarray, velocity: float) -> float:
        """Returns the greatest speed of the tool point on the path, where all joints start and arrive together [m/s].

        Args:
            model: the arm.
            T_flange_tool: the tool point, shape (4, 4) [m].
            velocity: fraction of full joint speed, above 0.
        """
        duration = self.least_duration(velocity * model.max_speed)
        if duration == 0.0:
            return 0.0
        speeds = (self.target - self.start) / duration
        path = (self.start + part * (self.target - self.start) for part in np.linspace(0.0, 1.0, STEPS))
        return max(float(np.linalg.norm(jacobian(model, q, T_flange_tool)[:3] @ speeds)) for q in path)

    def least_duration(self, speeds: np.ndarray) -> float:
        """Returns how long it takes at the joint speeds, shape (7,) [rad/s], without the time to speed up [s]."""
        return float(np.max(np.abs(self.target - self.start) / speeds))

    def table(self) -> list[str]:
        """Returns lines that show the present joints, the target and the steps between them."""
        rows = zip(*(np.degrees(joints).round(1) + 0.0 for joints in (self.start, self.target)))
        lines = ["joint   now [deg]   target [deg]   step [deg]"]
        return lines + [f"{i + 1:5d}{a:12.1f}{b:15.1f}{b - a:+13.1f}" for i, (a, b) in enumerate(rows)]


def _largest(difference: np.ndarray) -> tuple[int, float]:
    joint = int(np.argmax(np.abs(difference)))
    return joint + 1, float(np.degrees(difference[joint]))

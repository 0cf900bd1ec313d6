"""One motion from joints to joints: what it will do, how far it is, and whether it goes on. Radians and seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from iiwa_kinematics import jacobian
from iiwa_kinematics.robot_model import RobotModel

STEPS = 101
"""So many places on the way are looked at for the speed of the tool."""

ARRIVED_DEG = 0.1
"""The arm is at a configuration if no joint is further from it than this [deg]."""

MOVED_RAD = np.radians(0.02)
"""Less than this is no motion."""

STALLED_S = 3.0
"""After so long without motion the person is told [s]."""

GIVEN_UP_S = 60.0
"""After so long without motion nobody waits any more [s]."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """A motion that is to be made.

    Attributes:
        start: joints before, shape (7,) [rad].
        target: joints after, shape (7,) [rad].
    """

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
        """Returns the greatest speed of the tool point on the way, where all joints start and arrive together [m/s].

        Args:
            model: the arm.
            T_flange_tool: the tool point, shape (4, 4) [m].
            velocity: share of full joint speed, above 0.
        """
        duration = self.least_duration(velocity * model.max_speed)
        if duration == 0.0:
            return 0.0
        speeds = (self.target - self.start) / duration
        way = (self.start + part * (self.target - self.start) for part in np.linspace(0.0, 1.0, STEPS))
        return max(float(np.linalg.norm(jacobian(model, q, T_flange_tool)[:3] @ speeds)) for q in way)

    def least_duration(self, speeds: np.ndarray) -> float:
        """Returns how long it takes at the joint speeds, shape (7,) [rad/s], without the time to speed up [s]."""
        return float(np.max(np.abs(self.target - self.start) / speeds))

    def table(self) -> list[str]:
        """Returns lines that show the present joints, the target and the steps between them."""
        rows = zip(*(np.degrees(joints).round(1) + 0.0 for joints in (self.start, self.target)))
        lines = ["joint   now [deg]   target [deg]   step [deg]"]
        return lines + [f"{i + 1:5d}{a:12.1f}{b:15.1f}{b - a:+13.1f}" for i, (a, b) in enumerate(rows)]


@dataclass(frozen=True)
class Progress:
    """How far a motion is.

    Attributes:
        share: of the way of the joint that turns furthest, 0 to 1.
        joint: the joint that has furthest to go, 1 to 7.
        remaining: how far that is [deg].
        still: for how long the arm has not moved [s].
    """

    share: float
    joint: int
    remaining: float
    still: float

    @property
    def stalled(self) -> bool:
        """Whether the person should be told that the arm does not move."""
        return self.still >= STALLED_S

    @property
    def given_up(self) -> bool:
        """Whether there is nothing to wait for any more."""
        return self.still >= GIVEN_UP_S

    def bar(self, width: int = 30) -> str:
        """Returns a line with a bar of `width` characters and what remains."""
        filled = int(self.share * width)
        ahead = f"{self.remaining:6.1f} deg left (joint {self.joint})"
        return f"[{'#' * filled}{'.' * (width - filled)}] {100.0 * self.share:3.0f} %  {ahead}"


class MotionWatch:
    """Tells the progress of a motion from one reading of the joints to the next.

    Args:
        motion: the motion.
        now: when it starts [s].
    """

    def __init__(self, motion: JointMotion, now: float) -> None:
        self._motion = motion
        self._moved_at = now
        self._last = motion.start

    def step(self, q: np.ndarray, now: float) -> Progress:
        """Returns the progress with the joints at q, shape (7,) [rad], at the time `now` [s]."""
        if np.max(np.abs(q - self._last)) > MOVED_RAD:
            self._last, self._moved_at = np.array(q), now
        joint, remaining = _largest(self._motion.target - q)
        whole = abs(self._motion.largest[1])
        share = 1.0 - abs(remaining) / whole if whole > 0.0 else 1.0
        return Progress(min(max(share, 0.0), 1.0), joint, abs(remaining), now - self._moved_at)


def _largest(difference: np.ndarray) -> tuple[int, float]:
    joint = int(np.argmax(np.abs(difference)))
    return joint + 1, float(np.degrees(difference[joint]))

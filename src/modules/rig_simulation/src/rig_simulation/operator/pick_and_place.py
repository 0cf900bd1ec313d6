"""The operator picks an object up and puts it down: a state machine from observations to moves of the hand.

The operator compares the tool with the object and moves the hand by the difference until they match; all that is known
of the controller is that the tool follows the hand. Positions in metres in `kuka/base_frame`, times in seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rig_simulation.operator.motion import MIN_JERK_PEAK
from rig_simulation.world.scene import Cuboid, SceneObject

UP = np.array([0.0, 0.0, 1.0])
SHORTEST_MOVE_S, SETTLE_S = 0.4, 0.3
FINGER_FRACTION = 0.6  # the operator's fingers move for this fraction of the robot fingers' time
WIDEST = 0.1  # longest side that fits between the fingers


def heading(R_base_tool: np.ndarray) -> float:
    """Returns the direction from above of the x axis of the tool's orientation, along which the fingers close."""
    return math.atan2(R_base_tool[1, 0], R_base_tool[0, 0])


def wrapped(angle: float, period: float = 2.0 * math.pi) -> float:
    """Returns the angle within plus and minus half of the period."""
    return (angle + period / 2.0) % period - period / 2.0


def turn_to(shape: SceneObject, R_base_object: np.ndarray, fingers: float) -> float:
    """Returns the smallest turn after which the fingers, which close along the direction `fingers`, do so along a side
    that fits; 0 for a round object.
    The object of this shape stands upright in the orientation `R_base_object`, shape (3, 3).
    """
    if not isinstance(shape, Cuboid):
        return 0.0
    sides = shape.size[:2]
    fitting = [axis for axis in (0, 1) if sides[axis] <= WIDEST] or [int(np.argmin(sides))]
    turns = [wrapped(math.atan2(R_base_object[1, axis], R_base_object[0, axis]) - fingers, math.pi) for axis in fitting]
    return min(turns, key=abs)


@dataclass(frozen=True)
class Plan:
    """Parameters of the work."""

    clearance: float = 0.12  # of the grip above the object before it is grasped [m]
    grasp_height: float = 0.07  # of the grip above the object's top while it is grasped [m]
    lift: float = 0.215  # how high it is lifted [m]
    speed: float = 0.1  # highest speed of the palm [m/s]
    turn_speed: float = 0.5  # highest angular speed of the hand about the vertical [rad/s]
    tolerance: float = 0.004  # accepted distance of the tool from its target [m]
    turn_tolerance: float = 0.05  # accepted angle of the tool about the vertical [rad]
    most_turn: float = 0.4  # largest turn of the hand; the arm follows no further [rad]
    at_rest: float = 0.005  # speed below which the tool counts as at rest [m/s]
    closing: float = 2.5  # time for the fingers [s]
    opening: float = 1.5  # time for the fingers [s]
    hold: float = 1.0  # time for which the object is held up [s]
    patience: float = 30.0  # longest time for one step [s]


@dataclass(frozen=True)
class PickView:
    """The operator's observation."""

    grip: np.ndarray  # gripping point of the tool, shape (3,) [m]
    top: np.ndarray  # centre of the object's upper side, shape (3,) [m]
    clearance: float  # height of the object's lowest point above the table [m]
    following: bool = True  # whether the arm follows the hand
    turn: float = 0.0  # turn of the tool after which the fingers fit the object, anticlockwise from above [rad]


@dataclass(frozen=True)
class Move:
    """Target of the hand: right, up and back from its entry [m], yaw to the right [rad], curl 0 to 1, time [s]."""

    palm: np.ndarray
    yaw: float
    curl: float
    seconds: float

    @property
    def fields(self) -> dict[str, float]:
        """Fields of the request `reach` of the simulated Leap service."""
        right, up, back = self.palm.tolist()
        return {"right": right, "up": up, "back": back, "yaw": self.yaw, "curl": self.curl, "seconds": self.seconds}


@dataclass(frozen=True)
class PickStep:
    """Result of a cycle: the name of the step, a move of the hand or None, and why the operator gave up."""

    step: str
    move: Move | None = None
    failure: str = ""

    @property
    def over(self) -> bool:
        """Whether the work is over."""
        return self.step == "done" or bool(self.failure)


STEPS = ("wait", "above", "down", "close", "lift", "hold", "lower", "open", "away", "done")


class PickAndPlace:
    """The operator at work; call `step` about ten times a second.

    `center_line`: direction of the workspace, shape (3,), z = 0; the hand points along it when it comes in.
    """

    def __init__(self, plan: Plan, center_line: np.ndarray) -> None:
        forward = np.asarray(center_line, dtype=float) / np.linalg.norm(center_line)
        self._plan = plan
        self._R_leap_base = np.array([np.cross(forward, UP), UP, -forward])
        self._palm, self._yaw, self._curl = np.zeros(3), 0.0, 0.0
        self._step = 0
        self._since: float | None = None
        self._busy_until = 0.0
        self._target: np.ndarray | None = None
        self._before: tuple[float, np.ndarray] | None = None

    def step(self, view: PickView, now: float) -> PickStep:
        """Takes an observation at the time `now` [s]; returns what to do."""
        at_rest, name = self._at_rest(view.grip, now), STEPS[self._step]
        if name == "done":
            return PickStep(name)
        if self._since is None:
            self._since = now
        if now - self._since > self._plan.patience:
            return PickStep(name, failure=self._complaint(name, view))
        if now < self._busy_until or not at_rest or not view.following:
            return PickStep(name)
        if self._target is not None:
            error, turn = self._target - view.grip, self._turn(name, view)
            if np.linalg.norm(error) > self._plan.tolerance or abs(turn) > self._plan.turn_tolerance:
                return PickStep(name, self._shift(error, now, turn))
        self._step += 1
        self._since, self._target = now, None
        return self._begin(STEPS[self._step], view, now)

    def _begin(self, name: str, view: PickView, now: float) -> PickStep:
        plan = self._plan
        if name == "close":
            return PickStep(name, self._bend(1.0, plan.closing, now))
        if name == "open":
            return PickStep(name, self._bend(0.0, plan.opening, now))
        if name == "hold":
            self._busy_until = now + plan.hold
        targets = {
            "above": view.top + plan.clearance * UP,
            "down": view.top + plan.grasp_height * UP,
            "lift": view.grip + plan.lift * UP,
            "lower": view.grip - view.clearance * UP,
            "away": view.grip + plan.clearance * UP,
        }
        self._target = targets.get(name)
        if self._target is None:
            return PickStep(name)
        return PickStep(name, self._shift(self._target - view.grip, now, self._turn(name, view)))

    def _turn(self, name: str, view: PickView) -> float:
        """Returns the remaining turn [rad]: only above the object, and no further than the arm follows."""
        if name != "above":
            return 0.0
        most = self._plan.most_turn
        return float(np.clip(view.turn, self._yaw - most, self._yaw + most))

    def _shift(self, shift: np.ndarray, now: float, turn: float) -> Move:
        """Returns the move that shifts the tool by `shift`, shape (3,) [m], in the base and turns it [rad]."""
        self._palm = self._palm + self._R_leap_base @ shift
        self._yaw -= turn
        fastest = max(float(np.linalg.norm(shift) / self._plan.speed), abs(turn) / self._plan.turn_speed)
        seconds = max(SHORTEST_MOVE_S, MIN_JERK_PEAK * fastest)
        self._busy_until = now + seconds + SETTLE_S
        return Move(self._palm, self._yaw, self._curl, seconds)

    def _bend(self, curl: float, seconds: float, now: float) -> Move:
        """Returns the move of the fingers; the robot's fingers, which are slower, get `seconds` in all."""
        self._curl = curl
        self._busy_until = now + seconds
        return Move(self._palm, self._yaw, curl, FINGER_FRACTION * seconds)

    def _at_rest(self, grip: np.ndarray, now: float) -> bool:
        before, self._before = self._before, (now, grip)
        if before is None or now <= before[0]:
            return False
        return float(np.linalg.norm(grip - before[1])) / (now - before[0]) < self._plan.at_rest

    def _complaint(self, name: str, view: PickView) -> str:
        if not view.following:
            return f"the arm did not follow within {self._plan.patience:g} s (step {name!r})"
        if self._target is not None:
            off = 1e3 * np.linalg.norm(self._target - view.grip)
            return f"the tool stayed {off:.0f} mm off the target of step {name!r}"
        return f"step {name!r} took longer than {self._plan.patience:g} s"

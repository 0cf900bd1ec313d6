"""The operator picks an object up and puts it down: a state machine from observations to moves of the hand. The
operator compares the tool with the object and moves the hand by the difference until they match; all that is known of
the controller is that the tool follows the hand. Positions in metres in `kuka/base_frame`, times in seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from rig_simulation.operator.steering import UP, Habits, Move, SteeringHand
from rig_simulation.world.scene import Cuboid, SceneObject


def heading(R_base_tool: np.ndarray) -> float:
    """Returns the direction from above of the x axis of the tool's orientation, along which the fingers close."""
    return math.atan2(R_base_tool[1, 0], R_base_tool[0, 0])


def wrapped(angle: float, period: float = 2.0 * math.pi) -> float:
    """Returns the angle within plus and minus half of the period."""
    return (angle + period / 2.0) % period - period / 2.0


def turn_to(shape: SceneObject, R_base_object: np.ndarray, fingers: float) -> float:
    """Returns the smallest turn after which the fingers, which close along the direction `fingers`, do so along a side
    that fits; 0 for a round object. The object of this shape stands upright in the orientation `R_base_object`, shape
    (3, 3)."""
    widest = 0.1  # longest side that fits between the fingers
    if not isinstance(shape, Cuboid):
        return 0.0
    sides = shape.size[:2]
    fitting = [axis for axis in (0, 1) if sides[axis] <= widest] or [int(np.argmin(sides))]
    turns = [wrapped(math.atan2(R_base_object[1, axis], R_base_object[0, axis]) - fingers, math.pi) for axis in fitting]
    return min(turns, key=abs)


@dataclass(frozen=True)
class Plan(Habits):
    """Parameters of the work."""

    clearance: float = 0.12  # of the grip above the object before it is grasped [m]
    grasp_height: float = 0.07  # of the grip above the object's top while it is grasped [m]
    lift: float = 0.215  # how high it is lifted [m]
    tolerance: float = 0.004  # accepted distance of the tool from its target [m]
    turn_tolerance: float = 0.05  # accepted angle of the tool about the vertical [rad]
    most_turn: float = 0.4  # largest turn of the hand; the arm follows no further [rad]
    hold: float = 1.0  # time for which the object is held up [s]


@dataclass(frozen=True)
class PickView:
    """The operator's observation."""

    grip: np.ndarray  # gripping point of the tool, shape (3,) [m]
    top: np.ndarray  # centre of the object's upper side, shape (3,) [m]
    clearance: float  # height of the object's lowest point above the table [m]
    following: bool = True  # whether the arm follows the hand
    turn: float = 0.0  # turn of the tool after which the fingers fit the object, anticlockwise from above [rad]
    approach: np.ndarray = field(default_factory=lambda: -UP)  # along which the hand comes, a unit vector, shape (3,)


@dataclass(frozen=True)
class PickStep:
    """Result of a cycle: the name of the step, a move of the hand or None, and why the operator gave up."""

    step: str
    move: Move | None = None
    failure: str = ""

    @property
    def over(self) -> bool:
        return self.step == "done" or bool(self.failure)


STEPS = ("wait", "above", "down", "close", "lift", "hold", "lower", "open", "away", "done")
PICK = (*STEPS[:6], "done")
"""Without putting it down."""
TAKE_OVER = ("wait", "close", "open", "away", *PICK[1:])
"""PICK after a policy, whose fingers may be about the object: closes, so that they engage, then opens and rises."""


class PickAndPlace:
    """The operator at work; call `step` about ten times a second. `center_line`: direction of the workspace, shape
    (3,), z = 0; the hand points along it when it comes in. `steps`: of STEPS."""

    def __init__(self, plan: Plan, center_line: np.ndarray, steps: tuple[str, ...] = STEPS) -> None:
        self._plan, self._steps = plan, steps
        self._hand = SteeringHand(plan, center_line)
        self._step = 0
        self._since: float | None = None
        self._target: np.ndarray | None = None

    def step(self, view: PickView, now: float) -> PickStep:
        """Takes an observation at the time `now` [s]; returns what to do."""
        name = self._steps[self._step]
        self._hand.see(view.grip, now)
        if name == "done":
            return PickStep(name)
        if self._since is None:
            self._since = now
        if now - self._since > self._plan.patience:
            return PickStep(name, failure=self._complaint(name, view))
        if not self._hand.ready(now) or not view.following:
            return PickStep(name)
        if self._target is not None:
            error, turn = self._error(name, self._target, view), self._turn(name, view)
            if np.linalg.norm(error) > self._plan.tolerance or abs(turn) > self._plan.turn_tolerance:
                return PickStep(name, self._hand.shift(error, now, turn))
        self._step += 1
        self._since, self._target = now, None
        return self._begin(self._steps[self._step], view, now)

    def _begin(self, name: str, view: PickView, now: float) -> PickStep:
        plan = self._plan
        if name == "close":
            return PickStep(name, self._hand.close(now))
        if name == "open":
            return PickStep(name, self._hand.open(now))
        if name == "hold":
            self._hand.wait(plan.hold, now)
        targets = {
            "above": view.top - plan.clearance * view.approach,
            "down": view.top - plan.grasp_height * view.approach,
            "lift": view.grip + plan.lift * UP,
            "lower": view.grip - view.clearance * UP,
            "away": view.grip - plan.clearance * view.approach,
        }
        self._target = targets.get(name)
        if self._target is None:
            return PickStep(name)
        return PickStep(name, self._hand.shift(self._target - view.grip, now, self._turn(name, view)))

    @staticmethod
    def _error(name: str, target: np.ndarray, view: PickView) -> np.ndarray:
        """Returns what the tool lacks to its target, shape (3,) [m]; away from the object, only along the approach: the
        sideways position does not matter there, and may be out of reach."""
        error: np.ndarray = target - view.grip
        return (error @ view.approach) * view.approach if name == "away" else error

    def _turn(self, name: str, view: PickView) -> float:
        """Returns the remaining turn [rad]: only above the object, and no further than the arm follows."""
        if name != "above":
            return 0.0
        most = self._plan.most_turn
        return float(np.clip(view.turn, self._hand.yaw - most, self._hand.yaw + most))

    def _complaint(self, name: str, view: PickView) -> str:
        if not view.following:
            return f"the arm did not follow within {self._plan.patience:g} s (step {name!r})"
        if self._target is not None:
            off = 1e3 * np.linalg.norm(self._error(name, self._target, view))
            return f"the tool stayed {off:.0f} mm off the target of step {name!r}"
        return f"step {name!r} took longer than {self._plan.patience:g} s"

"""The operator hands a long box from one arm to the other: each hand of the operator steers one arm.

The giver takes the box at one end, lifts it and brings it between the arms; the taker takes the other end, the giver
lets go, and the taker puts the box down on its own side. So the robot hands stay as far apart as the two ends.

The giver's hand sways by half a degree, and the other end, half a metre away, by 5 mm (standard deviations). So the
taker aims at where that end is, not at where it was, and closes its fingers as soon as it is low enough. And the giver
does not let go before the taker has the box deep between its fingers: a taker that missed opens them, goes back and
takes again.
Positions in metres in `world`, times in seconds."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from rig_simulation.operator.pick_and_place import Plan, heading, turn_to
from rig_simulation.operator.steering import UP, Move, SteeringHand
from rig_simulation.world.scene import Cuboid

GIVER, TAKER, BOTH = "giver", "taker", "both"
STEPS = {
    "wait": BOTH,
    "above": GIVER,
    "down": GIVER,
    "close": GIVER,
    "lift": GIVER,
    "bring": GIVER,
    "reach": TAKER,
    "approach": TAKER,
    "take": TAKER,
    "let go": GIVER,
    "part": GIVER,
    "carry": TAKER,
    "lower": TAKER,
    "open": TAKER,
    "away": TAKER,
    "done": BOTH,
}
"""The steps in their order, and whose hand moves."""
AGAIN = "again"  # the taker, which missed, opens its fingers; "reach" follows
WHO = {**STEPS, AGAIN: TAKER}
CLOSES, OPENS = ("close", "take"), ("let go", "open", AGAIN)
AT_THE_BOX = ("above", "down", "reach", "approach")  # the target is at the box, and moves with it
UP_IN_THE_AIR = ("bring", "reach", "approach", "take", AGAIN, "let go", "part", "carry", "lower")  # the box is held
NEXT = {**dict(zip(STEPS, list(STEPS)[1:])), AGAIN: "reach"}
BEFORE_CLOSE = list(STEPS)[: list(STEPS).index("close")]
FINGERS = (1, 2, 3)  # in the names of the robot hand's links


@dataclass(frozen=True)
class HandOverPlan(Plan):
    """Parameters of the work."""

    lift: float = 0.15  # how high the box is lifted [m]
    grasp_height: float = 0.022  # of the grip above the box's top: the palm is 8 mm above it [m]
    take_height: float = 0.015  # the same of the taker, whose palm may touch the box in the air [m]
    deep: float = 0.024  # of the taker's grip above the box's top, at most: higher fingers push the box away [m]
    beside: float = 0.008  # accepted distance of the taker beside its target: the fingers pull the box in [m]
    from_end: float = 0.075  # of the gripping point from the end of the box [m]
    takes: int = 3  # of the taker, at most
    finger_patience: float = 3.0  # longest time for the robot's fingers beyond the operator's [s]


@dataclass(frozen=True)
class LongBox:
    """A box that lies on a side, and where it is taken: at both ends of its longest edge."""

    shape: Cuboid
    from_end: float  # of the gripping points from the ends [m]

    @property
    def axis(self) -> np.ndarray:
        """Direction of the longest edge in the box, shape (3,)."""
        return np.eye(3)[int(np.argmax(self.shape.size))]

    def top(self, T_world_box: np.ndarray, sign: float) -> np.ndarray:
        """Returns the point on the upper side where an end is taken, shape (3,) [m]; `sign`: of the end."""
        at = sign * (float(np.max(self.shape.size)) / 2.0 - self.from_end) * self.axis
        return T_world_box[:3, 3] + T_world_box[:3, :3] @ (at + self.shape.height / 2.0 * UP)

    def lowest(self, T_world_box: np.ndarray) -> float:
        """Returns the height of the lowest corner [m]."""
        corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * self.shape.size
        return float(np.min(corners @ T_world_box[2, :3]) + T_world_box[2, 3])


@dataclass(frozen=True)
class HandOverView:
    """The operator's observation; mappings by GIVER and TAKER."""

    grips: Mapping[str, np.ndarray]  # gripping points of the tools, shape (3,) [m]
    tools: Mapping[str, np.ndarray]  # orientations of the tools, shape (3, 3)
    T_world_box: np.ndarray  # shape (4, 4) [m]
    clearance: float  # height of the lowest point of the box above the table [m]
    touching: frozenset[str]  # whose robot hand has a finger at the box: GIVER, TAKER
    holding: frozenset[str]  # whose robot hand has it between thumb and fingers
    following: bool = True  # whether both arms follow their hands


@dataclass(frozen=True)
class HandOverStep:
    """Result of a cycle: the name of the step, whose hand moves how, and why the operator gave up."""

    step: str
    who: str = ""
    move: Move | None = None
    failure: str = ""

    @property
    def over(self) -> bool:
        return self.step == "done" or bool(self.failure)


@dataclass(frozen=True)
class Roles:
    """Which arm gives, which one takes, and where: horizontal positions of the middle of the box, shape (2,) [m]."""

    giver: str
    taker: str
    end: float  # sign of the end that the giver takes
    meeting: np.ndarray
    place: np.ndarray

    @property
    def names(self) -> dict[str, str]:
        return {GIVER: self.giver, TAKER: self.taker}


def roles(shape: Cuboid, T_world_box: np.ndarray, bases: Mapping[str, np.ndarray]) -> Roles:
    """Returns who gives: the arm that is nearer to the box. They meet in the middle, and the box ends where its mirror
    image stands. `bases`: positions of the bases of two arms, shape (3,) [m]; ValueError if they stand above each
    other."""
    middle = T_world_box[:2, 3]
    giver, taker = sorted(bases, key=lambda name: float(np.linalg.norm(bases[name][:2] - middle)))
    across = bases[taker][:2] - bases[giver][:2]
    length = float(np.linalg.norm(across))
    if length < 0.1:
        raise ValueError(f"The bases of {giver} and {taker} are {length:.2f} m apart, seen from above.")
    across = across / length
    beside = float((middle - (bases[giver][:2] + bases[taker][:2]) / 2.0) @ across) * across
    axis = T_world_box[:2, :3] @ LongBox(shape, 0.0).axis
    return Roles(giver, taker, -1.0 if axis @ across > 0.0 else 1.0, middle - beside, middle - 2.0 * beside)


def fingers_at(touches: Collection[str], arm: str) -> set[int]:
    """Returns which fingers of an arm's robot hand touch an object, by the bodies that do; its palm may, too."""
    return {n for n in FINGERS if any(f"{arm}/reflex/{link}_{n}" in touches for link in ("proximal", "distal"))}


def between_fingers(touches: Collection[str], arm: str) -> bool:
    """Returns whether the robot hand of an arm has an object between thumb and fingers."""
    thumb = 3  # in the names of the robot hand's links
    fingers = fingers_at(touches, arm)
    return thumb in fingers and len(fingers) > 1


class BoxHandOver:
    """The operator at work; call `step` about ten times a second.

    Args:
        forward: by GIVER and TAKER, in which direction that hand points when it comes in, shape (3,), z = 0.
        shape: of the box.
        roles: who gives and where."""

    def __init__(self, plan: HandOverPlan, forward: Mapping[str, np.ndarray], shape: Cuboid, roles: Roles) -> None:
        self._plan, self._box = plan, LongBox(shape, plan.from_end)
        self._hands = {who: SteeringHand(plan, forward[who]) for who in (GIVER, TAKER)}
        self._ends = {GIVER: roles.end, TAKER: -roles.end}
        self._meeting, self._place = (np.array([*at, 0.0]) for at in (roles.meeting, roles.place))
        self._name, self._took = "wait", 0
        self._since: float | None = None
        self._target: np.ndarray | None = None

    @property
    def began(self) -> bool:
        """Whether the fingers have been moved: a hand that leaves now drops the box."""
        return self._name not in BEFORE_CLOSE

    def enters(self, who: str) -> float:
        """A hand comes in anew where its arm has kept the tool; returns the curl of its fingers, 0 to 1."""
        self._hands[who].enter()
        self._since = None
        return self._hands[who].curl

    def step(self, view: HandOverView, now: float) -> HandOverStep:
        """Takes an observation at the time `now` [s]; returns what to do."""
        held_m = 0.02  # a box whose lowest point is lower above the table is not held
        name = self._name
        for who, hand in self._hands.items():
            hand.see(view.grips[who], now)
        if name == "done":
            return HandOverStep(name)
        self._since = now if self._since is None else self._since
        if name in UP_IN_THE_AIR[:-1] and view.clearance < held_m:
            return HandOverStep(name, failure=f"the box fell (step {name!r})")
        if now - self._since > self._plan.patience:
            return HandOverStep(name, failure=self._complaint(name, view))
        who = WHO[name]
        moving = [self._hands[who]] if who != BOTH else list(self._hands.values())
        if not view.following or not all(hand.ready(now) for hand in moving):
            return HandOverStep(name)
        if name == "take" and not self._holds(view):
            if now - self._since <= self._plan.closing + self._plan.finger_patience:
                return HandOverStep(name)
            if self._took >= self._plan.takes:
                return HandOverStep(name, failure=self._complaint(name, view))
            return self._begin(AGAIN, view, now)
        if _fingers_move(name, who, view):
            return HandOverStep(name)
        if name in AT_THE_BOX:
            self._target = self._target_of(name, who, view)
        if self._target is not None:
            error, turn = self._target - view.grips[who], self._turn(name, who, view)
            if not self._matches(name, error) or abs(turn) > self._plan.turn_tolerance:
                return HandOverStep(name, who, self._hands[who].shift(error, now, turn))
        if name == "lift" and view.clearance < held_m:
            return HandOverStep(name, failure="the box was not lifted")
        return self._begin(NEXT[name], view, now)

    def _begin(self, name: str, view: HandOverView, now: float) -> HandOverStep:
        self._name, self._since, self._target = name, now, None
        self._took += name == "take"
        who = WHO[name]
        if who == BOTH:
            return HandOverStep(name)
        hand = self._hands[who]
        if name in CLOSES:
            return HandOverStep(name, who, hand.close(now))
        if name in OPENS:
            return HandOverStep(name, who, hand.open(now))
        self._target = self._target_of(name, who, view)
        move = hand.shift(self._target - view.grips[who], now, self._turn(name, who, view))
        return HandOverStep(name, who, move)

    def _target_of(self, name: str, who: str, view: HandOverView) -> np.ndarray:
        """Returns where the gripping point is to be, shape (3,) [m]."""
        plan, grip, T = self._plan, view.grips[who], view.T_world_box
        top = self._box.top(T, self._ends[who])
        level = np.array([1.0, 1.0, 0.0])
        if name in ("above", "reach"):
            return top + plan.clearance * UP
        if name == "down":
            return top + plan.grasp_height * UP
        if name == "approach":
            return top + plan.take_height * UP
        if name == "lift":
            return grip + plan.lift * UP
        if name in ("part", "away"):
            return grip + plan.clearance * UP
        if name == "lower":  # until this end lies: the other one hangs lower
            table = self._box.lowest(T) - view.clearance
            return grip - (top[2] - self._box.shape.height - table) * UP
        return grip + level * ((self._meeting if name == "bring" else self._place) - T[:3, 3])

    def _turn(self, name: str, who: str, view: HandOverView) -> float:
        """Returns the remaining turn [rad]: only before the box is taken, and no further than the arm follows."""
        if name not in ("above", "reach"):
            return 0.0
        most, yaw = self._plan.most_turn, self._hands[who].yaw
        turn = turn_to(self._box.shape, view.T_world_box[:3, :3], heading(view.tools[who]))
        return float(np.clip(turn, yaw - most, yaw + most))

    def _matches(self, name: str, error: np.ndarray) -> bool:
        """Returns whether the tool is where it is to be; `error`: from it to its target, shape (3,) [m]."""
        if name == "approach":  # to a swaying box: a hand that is lower than it need be takes it all the better
            beside = float(np.linalg.norm(error[:2]))
            return beside <= self._plan.beside and float(-error[2]) <= self._plan.tolerance
        return float(np.linalg.norm(error)) <= self._plan.tolerance

    def _holds(self, view: HandOverView) -> bool:
        """Returns whether the taker holds the box: with fingertips at its upper edges it does not."""
        above = view.grips[TAKER][2] - self._box.top(view.T_world_box, self._ends[TAKER])[2]
        return TAKER in view.holding and above < self._plan.deep

    def _complaint(self, name: str, view: HandOverView) -> str:
        if not view.following:
            return f"the arms did not follow within {self._plan.patience:g} s (step {name!r})"
        if name == "take":
            return f"the taker did not get hold of the box, grip {self._took}"
        if self._target is not None:
            off = 1e3 * np.linalg.norm(self._target - view.grips[WHO[name]])
            return f"the {WHO[name]}'s tool stayed {off:.0f} mm off the target of step {name!r}"
        return f"step {name!r} took longer than {self._plan.patience:g} s"


def _fingers_move(name: str, who: str, view: HandOverView) -> bool:
    """Returns whether the fingers have not yet done what the step is for; the robot's may take their time."""
    if name in CLOSES:
        return who not in view.touching
    return name in OPENS and who in view.touching

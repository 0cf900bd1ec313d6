"""From the desired tool frame to a joint target: scaling, workspace, inverse kinematics. Positions in the base frame
[m].

The factor scales displacements from the workspace centre, not rotations. Changed while the arm follows, it acts from
the present pose on: an offset keeps the tool where it is. Position first: a tool frame out of the arm's reach is tilted
by the least angle that brings it into reach. Where the joints would have to hurry although the tool does not, the tool
keeps its position and its orientation comes after it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.limits import Limit
from common.modes import TO_DESIRED_TOOL, Mode
from common.poses import pose, read_only
from common.rotations import rotation_angle
from iiwa_kinematics import Kinematics, approached, tilted
from kuka_control.model.desired_frame import rejection_reason
from kuka_control.model.workspace import Infeasible, Workspace

MAX_DEVIATION_RAD = float(np.radians(45.0))  # an orientation further from the desired one than this is not followed
HALF_TURN_RAD = float(np.pi)
"""A motion from rest that turns a joint by more than this is refused: the arm would unwind. Between poses within the
shipped workspaces, at the tilts that the operator is permitted, no joint turns by more than 165 deg."""
STEADY_RAD = float(np.radians(1.0))  # the joints hurry if their step is larger than this and what full speed allows
STEADY_TURN_RAD = float(np.radians(4.0))  # a tool frame with a step beyond these has jumped: the joints may, too
FAR_RAD = float(np.radians(60.0))  # joints that are further off than this are not approached at once
SHORTEST_S = 0.002  # the time between two frames counts as this and LONGEST_S at least and most, for the joints' steps
LONGEST_S = 0.05

SHOWN_RAD = float(np.radians(0.5))  # a smaller deviation is not reported

FROM_HERE = (*TO_DESIRED_TOOL, Mode.HOLDING.value)  # modes in which the arm goes to a desired frame from where it is


NO_OFFSET = read_only(np.zeros(3))


def scaled(position: np.ndarray, centre: np.ndarray, factor: float) -> np.ndarray:
    """Returns the position, shape (3,), moved towards the centre (factor < 1) or away from it (factor > 1)."""
    return centre + factor * (position - centre)


def unscaled(position: np.ndarray, centre: np.ndarray, factor: float) -> np.ndarray:
    """Returns the position, shape (3,), that `scaled` brings to the given one."""
    return centre + (position - centre) / factor


class MotionScaling(NamedTuple):
    """The scaling factor, and what is added to the scaled position since it was changed, shape (3,) [m]."""

    factor: float = 1.0
    offset: np.ndarray = NO_OFFSET


@dataclass(frozen=True)
class Target:
    """Where the arm is to go."""

    q: np.ndarray | None  # joints, shape (7,) [rad]; None when no valid solution reaches the tool frame
    T_base_tool: np.ndarray  # the tool frame after scaling, workspace and reach, shape (4, 4) [m]
    bounds: tuple[Limit, ...] = ()  # the workspace's bounds that acted
    failure: str | None = None  # why there are no joints, a sentence; None when there are
    deviation: float = 0.0  # angle between the desired orientation and that of T_base_tool [rad]

    @property
    def limited_by(self) -> tuple[Limit, ...]:
        """What keeps the tool from the desired frame: the workspace's bounds, and REACH if its orientation yields."""
        return (*self.bounds, Limit.REACH) if self.deviation > SHOWN_RAD else self.bounds

    @property
    def outside(self) -> str | None:
        if not self.bounds:
            return None
        bounds = " and the ".join(self.bounds)
        return f"The desired tool frame is outside the workspace; the tool stays at the {bounds}."

    @property
    def limitation(self) -> str | None:
        if self.deviation <= SHOWN_RAD:
            return None
        return (
            f"The desired orientation is out of the arm's reach; the tool keeps its position and deviates by "
            f"{np.degrees(self.deviation):.0f} deg."
        )


class TargetChain:
    """Composes the steps from the desired tool frame to joints. It has no state, so any thread may ask it. `centre`:
    from which displacements are scaled, shape (3,) [m]."""

    def __init__(self, centre: np.ndarray, workspace: Workspace, kinematics: Kinematics) -> None:
        self._centre = read_only(centre)
        self._workspace = workspace
        self._kinematics = kinematics

    def resolve(
        self,
        T_base_desired: np.ndarray,
        scaling: MotionScaling,
        q_seed: np.ndarray,
        before: Target | None = None,
        dt: float = 0.0,
    ) -> Target | Infeasible:
        """Returns the target of a desired tool frame, shape (4, 4) [m].

        Args:
            scaling: the scaling.
            q_seed: joints to continue from, shape (7,) [rad].
            before: the target that an arm in motion follows, `dt` [s] older; None for an arm at rest."""
        T_base_scaled = self._scaled(T_base_desired, scaling)
        target = self.reach(T_base_scaled, q_seed, before is not None)
        if before is None or isinstance(target, Infeasible) or target.q is None:
            return target
        return self._steady(target, T_base_scaled, q_seed, before, dt)

    def desired(self, T_base_tool: np.ndarray, scaling: MotionScaling) -> np.ndarray:
        """Returns the desired tool frame, shape (4, 4) [m], that the scaling makes the given one of."""
        position = unscaled(T_base_tool[:3, 3] - scaling.offset, self._centre, scaling.factor)
        return read_only(pose(T_base_tool[:3, :3], position))

    def rescaled(self, scaling: MotionScaling, factor: float, position: np.ndarray) -> MotionScaling:
        """Returns the scaling by another factor that brings a desired position, shape (3,) [m], to the same place."""
        shift = (scaling.factor - factor) * (position - self._centre)
        return MotionScaling(factor, read_only(scaling.offset + shift))

    def away(self, T_base_desired: np.ndarray, scaling: MotionScaling, q: np.ndarray) -> tuple[float, float]:
        """Returns how far a desired tool frame is from the tool at the joints q, shape (7,) [rad]: [m] and [rad]."""
        T_base_tool, T_base_scaled = self._kinematics.forward(q), self._scaled(T_base_desired, scaling)
        distance = float(np.linalg.norm(T_base_scaled[:3, 3] - T_base_tool[:3, 3]))
        return distance, _angle(T_base_tool, T_base_scaled)

    def _scaled(self, T_base_desired: np.ndarray, scaling: MotionScaling) -> np.ndarray:
        T_base_scaled = T_base_desired.copy()
        T_base_scaled[:3, 3] = scaled(T_base_desired[:3, 3], self._centre, scaling.factor) + scaling.offset
        return T_base_scaled

    def reach(self, T_base_scaled: np.ndarray, q_seed: np.ndarray, follows: bool = False) -> Target | Infeasible:
        """Returns the target of a tool frame that is scaled already, for an arm at rest or one that `follows`."""
        constrained = self._workspace.constrain(T_base_scaled[:3, 3])
        if isinstance(constrained, Infeasible):
            return constrained
        if constrained.bounds:
            T_base_scaled = pose(T_base_scaled[:3, :3], constrained.position)
        T_base_tool = read_only(T_base_scaled)
        result = self._kinematics.inverse(T_base_tool, q_seed=q_seed, keep_branch=follows)
        q, T_reached = result.q, T_base_tool
        if q is None:
            T_tilted = tilted(self._kinematics, T_base_tool, MAX_DEVIATION_RAD)
            if T_tilted is not None:
                T_reached = read_only(T_tilted)
                q = self._kinematics.inverse(T_tilted, q_seed=q_seed, keep_branch=follows).q
        if q is None:
            return Target(None, T_base_tool, constrained.bounds, str(result.failure))
        if not follows and max(abs(q - q_seed).tolist()) > HALF_TURN_RAD:
            return Target(None, T_base_tool, constrained.bounds, _refused_turn(np.abs(q - q_seed)))
        if T_reached is T_base_tool:
            return Target(q, T_base_tool, constrained.bounds)
        return Target(q, T_reached, constrained.bounds, None, _angle(T_base_tool, T_reached))

    def _steady(
        self, target: Target, T_base_scaled: np.ndarray, q_seed: np.ndarray, before: Target, dt: float
    ) -> Target:
        """Returns a target on the way to `target`, with the tool in its position, if the joints hurry but the tool
        does not; arguments as in `resolve`."""
        steady_m = 0.02
        steady_pace = 0.9  # fraction of full joint speed at which they come after it
        assert target.q is not None, "only a target with joints can be reached steadily"
        steps = np.abs(target.q - q_seed)
        if max(steps.tolist()) <= STEADY_RAD:
            return target
        within = self._kinematics.model.max_speed * min(max(dt, SHORTEST_S), LONGEST_S)
        if np.all(steps <= STEADY_RAD + within) or (not before.deviation and np.max(steps) > FAR_RAD):
            return target
        position = target.T_base_tool[:3, 3]
        jumped = np.linalg.norm(position - before.T_base_tool[:3, 3]) > steady_m
        if jumped or _angle(before.T_base_tool, T_base_scaled) > before.deviation + STEADY_TURN_RAD:
            return target
        q = approached(self._kinematics, position, q_seed, target.q, steady_pace * within)
        if q is None:
            return target
        T_base_tool = self._kinematics.forward(q)
        deviation = _angle(T_base_scaled, T_base_tool)
        if deviation > MAX_DEVIATION_RAD:
            return target
        return Target(read_only(q), read_only(T_base_tool), target.bounds, None, deviation)


def _angle(T: np.ndarray, T_other: np.ndarray) -> float:
    """Returns the angle [rad] between the orientations of two poses."""
    return rotation_angle(T[:3, :3].T @ T_other[:3, :3])


def _refused_turn(turns: np.ndarray) -> str:
    """Returns why joint turns, shape (7,) [rad], are refused, a sentence."""
    joint = int(np.argmax(turns))
    return (
        f"The motion there would turn joint {joint + 1} by {np.degrees(turns[joint]):.0f} deg, more than half a turn; "
        f"move the hand to where the arm comes in a shorter way."
    )


@dataclass(frozen=True)
class ToolCheck:
    sentence: str  # why the tool cannot be brought there, or that it can
    T_base_desired: np.ndarray | None = None  # the desired tool frame for that, shape (4, 4) [m]; None if it cannot
    obstacle: str | None = None  # why an arm that yields in orientation and at bounds cannot come there either
    q: np.ndarray | None = None  # joints of the tool pose, shape (7,) [rad]; None if it cannot


def refused(reason: str) -> ToolCheck:
    """Returns the answer to an invalid tool pose; `reason` is the end of a sentence."""
    return ToolCheck(f"The tool pose is refused: {reason}", obstacle=f"the tool pose is refused: {reason}")


def seed(mode: Mode, joints: np.ndarray | None, q_home: np.ndarray) -> np.ndarray:
    """Returns the joints from which the arm would go to a pose, shape (7,) [rad]; `joints` are the measured ones."""
    return joints if mode in FROM_HERE and joints is not None else q_home


def check_tool_pose(
    chain: TargetChain,
    T_base_tool: np.ndarray,
    scaling: MotionScaling,
    q_seed: np.ndarray,
    follows: bool = False,
    collision: Callable[[np.ndarray], str | None] = lambda q: None,
) -> ToolCheck:
    """Returns whether the tool can be brought to a pose, shape (4, 4) [m], from the joints `q_seed`, shape (7,) [rad]:
    those of an arm that follows, else of home, where it always goes first. It does not check the path. In servo mode
    the arm `follows`: it does not fold differently, and nearer to a body than the collision guard allows it stops by
    itself. `collision` returns which bodies meet at joints, shape (7,) [rad]."""
    reason = rejection_reason(T_base_tool)
    if reason is not None:
        return refused(reason)
    target = chain.reach(T_base_tool, q_seed, follows)
    if isinstance(target, Infeasible):
        return ToolCheck(f"The tool pose is outside the workspace: {target}.", obstacle=str(target))
    meets = None if target.q is None or target.failure is not None else collision(target.q)
    blocked = None if follows else meets
    if target.bounds:
        moved = 1e3 * np.linalg.norm(target.T_base_tool[:3, 3] - T_base_tool[:3, 3])
        return ToolCheck(
            f"The tool pose is outside the workspace: the {' and the '.join(target.bounds)} would move it by "
            f"{moved:.0f} mm.",
            obstacle=target.failure or blocked,
        )
    if target.failure is not None:
        return ToolCheck(target.failure, obstacle=target.failure)
    if meets is not None:
        return ToolCheck(f"The collision guard refuses the tool pose: {meets}.", obstacle=blocked)
    if target.deviation:
        return ToolCheck(
            f"The tool pose is out of reach: in this position the tool would deviate from it by "
            f"{np.degrees(target.deviation):.1f} deg."
        )
    return ToolCheck("The arm can bring the tool there.", chain.desired(T_base_tool, scaling), q=target.q)

"""The scenario hand_over on the running rig: both hands of the simulated operator, both arms, and one long box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rospy

from common import clock
from common.arms import arms_from
from common.errors import RigError
from common.poses import pose
from common.rotations import rotation_from_quaternion
from rig_simulation.control_port import ControlClient
from rig_simulation.operator.hand_over import (
    BoxHandOver,
    HandOverPlan,
    HandOverStep,
    HandOverView,
    between_fingers,
    fingers_at,
    roles,
)
from rig_simulation.operator.visits import Visits
from rig_simulation.ros.seen_arm import SeenArm
from rig_simulation.world.scene import Cuboid, scene_from

PERIOD_S = 0.1
AWAY_S = 2.0  # a hand is out of view before it comes in again
THING = "box"


class HandOverScenario:
    """Hands the object `box` from the arm that is nearer to it to the other one. The progress of each arm names the
    `thing`, the `giver` and the `taker`. `leapd` and `world` are control ports, as for a Scenario; `arms`: two
    namespaces."""

    def __init__(self, name: str, leapd: ControlClient, world: ControlClient, arms: Sequence[str]) -> None:
        self._leapd, self._world, self._time = leapd, world, 0.0
        shape = scene_from(world.ask("scene")["scene"]).objects.get(THING)
        if not isinstance(shape, Cuboid):
            raise RigError(f"The scenario {name} needs an object {THING!r} of the kind box in its scene.")
        self._shape = shape
        self._arms = {arm: SeenArm(name, arm) for arm in arms}
        self._T_world_base = {
            arm: place.T_world_base for arm, place in arms_from(rospy.get_param("arms"), "arms/").placements.items()
        }
        self._roles = roles(shape, self._box()[0], {arm: self._T_world_base[arm][:3, 3] for arm in arms})
        self._visits = {arm: Visits() for arm in arms}

    def run(self) -> None:
        """Runs until the work is over or ROS shuts down, then takes the hands away; DeviceError if devices fail."""
        self._start()
        while not rospy.is_shutdown():
            clock.sleep(PERIOD_S)
            if any(arm.grip is None for arm in self._arms.values()):
                continue
            now = clock.monotonic()
            if self._operator.began:
                self._come_in_again(now)
            result = HandOverStep("wait") if self._starts_over(now) else self._operator.step(*self._view())
            if result.move is not None:
                self._leapd.ask("reach", side=self._roles.names[result.who], **result.move.fields)
            self._tell(result)
            if result.over:
                break
        for arm in self._arms:
            self._leapd.ask("hide", side=arm)

    def _start(self) -> None:
        forward = {
            who: self._T_world_base[arm][:3, :3] @ self._arms[arm].center_line for who, arm in self._roles.names.items()
        }
        self._operator = BoxHandOver(HandOverPlan(), forward, self._shape, self._roles)
        for arm in self._arms:
            self._show(arm)

    def _show(self, arm: str, curl: float = 0.0) -> None:
        """Brings a hand into its interaction box; `curl`: of its fingers, 0 to 1."""
        entry_m = 0.25  # a hand enters so far in front of its workspace's centre
        entry_s = 1.0  # and needs so long to it
        self._leapd.ask("show", back=entry_m, curl=curl, side=arm)
        self._leapd.ask("reach", seconds=entry_s, curl=curl, side=arm)
        self._visits[arm].enter(clock.monotonic())

    def _come_in_again(self, now: float) -> None:
        """Takes each hand away and back whose stream has ended while its arm keeps the tool, as with relative
        engagement."""
        for who, name in self._roles.names.items():
            arm = self._arms[name]
            if self._visits[name].over(arm.streams, now) and arm.following:
                rospy.logwarn("%s: the tool is kept: the hand leaves the view and comes in again.", name)
                self._leapd.ask("hide", side=name)
                clock.sleep(AWAY_S)
                self._show(name, self._operator.enters(who))

    def _starts_over(self, now: float) -> bool:
        """Takes both hands away and starts over if an arm does not follow and holds nothing; returns whether."""
        if self._operator.began:
            return False
        over = [self._visits[name].over(arm.following, now) for name, arm in self._arms.items()]
        if not any(over):
            return False
        rospy.logwarn("An arm does not follow: the hands leave the view, come in again, and start over.")
        for arm in self._arms:
            self._leapd.ask("hide", side=arm)
        clock.sleep(AWAY_S)
        self._start()
        return True

    def _box(self) -> tuple[np.ndarray, float, list[str]]:
        """Returns the pose of the box in world, shape (4, 4) [m], its clearance above the table [m], and the bodies
        that touch it."""
        answer = self._world.ask("objects")
        seen, self._time = answer["objects"][THING], answer["time"]
        return pose(rotation_from_quaternion(seen["quaternion"]), seen["position"]), seen["clearance"], seen["touches"]

    def _view(self) -> tuple[HandOverView, float]:
        """Returns the observation, and its time in the world, which may be slower than the machine's [s]: the robot's
        fingers are, too."""
        T_world_box, clearance, touches = self._box()
        names = self._roles.names.items()
        touching = frozenset(who for who, arm in names if fingers_at(touches, arm))
        holding = frozenset(who for who, arm in names if between_fingers(touches, arm))
        grips, tools = {}, {}
        for who, name in names:
            T, arm = self._T_world_base[name], self._arms[name]
            grips[who], tools[who] = T[:3, :3] @ arm.grip + T[:3, 3], T[:3, :3] @ arm.R
        following = all(arm.following and arm.streams for arm in self._arms.values())
        return HandOverView(grips, tools, T_world_box, clearance, touching, holding, following), self._time

    def _tell(self, result: HandOverStep) -> None:
        for arm in self._arms.values():
            arm.tell(result.step, result.failure, thing=THING, **self._roles.names)

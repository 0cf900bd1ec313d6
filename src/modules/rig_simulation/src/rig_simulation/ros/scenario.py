"""A scenario on the running rig: what the simulated person sees and does, and how far it is.

Publishes `simulation/scenario` (diagnostic_msgs/DiagnosticStatus, latched): its message is the present step, its values
are scenario, step and failure; level OK while it goes well and when it is done, ERROR when it was given up.
"""

from __future__ import annotations

import time

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String

from common.config import parse
from common.errors import RigError
from common.ros.conversions import pose_from_message
from common.tool import ToolConfig
from rig_simulation.control_port import ControlClient
from rig_simulation.scenario.pick_and_place import PickAndPlace, Plan, Result, View
from rig_simulation.world.scene import scene_from

SCENARIOS = {"pick_cup": "cup"}
"""The object of each scenario."""
PERIOD_S = 0.1
GRIP_OFFSET = (-0.0152, 0.0, 0.0)
"""From the tool point to the middle between fingers and thumb, in the flange's axes [m]: the hand's x axis points back
there, and its knuckles stand at x = 60.4 mm and x = -30 mm."""

FOLLOWING = "servo"
LOST_S, AWAY_S, MOST_VISITS = 2.0, 2.0, 3
"""After the stream broke off: when the person notices, how long the hand stays out of view, how often it comes in."""
TOPIC = "simulation/scenario"


class Scenario:
    """One scenario.

    Args:
        name: a key of SCENARIOS.
        leapd: control port of the simulated Leap service, which must run guided.
        world: control port of the simulated world.

    Raises:
        RigError: the rig or its world is not what the scenario needs.
    """

    def __init__(self, name: str, leapd: ControlClient, world: ControlClient) -> None:
        self._name, self._object = name, SCENARIOS[name]
        self._leapd, self._world = leapd, world
        kuka = rospy.get_param("kuka")
        if any(kuka.get("mounting", [0.0])):
            raise RigError(f"The scenario {name} needs an upright arm; kuka/mounting is {kuka['mounting']}.")
        self._T_flange_tool = parse(ToolConfig, kuka, "kuka/", others=kuka).T_flange_tool
        self._center_line = np.asarray(kuka["center_line"], dtype=float)
        objects = scene_from(world.ask("scene")["scene"]).objects
        if self._object not in objects:
            raise RigError(f"The scenario {name} needs an object {self._object!r}; the scene has {sorted(objects)}.")
        self._height = objects[self._object].height
        self._grip: np.ndarray | None = None
        self._mode = ""
        self._step = ""
        self._publisher = rospy.Publisher(TOPIC, DiagnosticStatus, queue_size=10, latch=True)
        rospy.Subscriber("simulation/flange", PoseStamped, self._take_flange, queue_size=1)
        rospy.Subscriber("kuka/mode", String, self._take_mode, queue_size=10)

    def run(self) -> None:
        """Works until the scenario is over or ROS shuts down, then takes the hand away.

        Raises:
            DeviceError: the world or the Leap service does not answer.
        """
        person, visits, followed = self._come_in(), 1, None
        while not rospy.is_shutdown():
            time.sleep(PERIOD_S)
            if self._grip is None:
                continue
            view, now = self._view(), time.monotonic()
            if view.following:
                followed = now
            elif followed is not None and now - followed > LOST_S and visits < MOST_VISITS:
                rospy.logwarn("The arm follows no more: the hand goes out, comes in again, and starts anew.")
                self._leapd.ask("hide")
                time.sleep(AWAY_S)
                person, visits, followed = self._come_in(), visits + 1, None
                continue
            result = person.step(view, now)
            if result.move is not None:
                self._leapd.ask("reach", **result.move.fields)
            self._tell(result)
            if result.over:
                break
        self._leapd.ask("hide")

    def _come_in(self) -> PickAndPlace:
        self._leapd.ask("show")
        return PickAndPlace(Plan(), self._center_line)

    def _view(self) -> View:
        seen = self._world.ask("objects")["objects"][self._object]
        top = np.add(seen["position"], (0.0, 0.0, self._height / 2.0))
        return View(self._grip, top, seen["clearance"], self._mode == FOLLOWING)

    def _tell(self, result: Result) -> None:
        if result.step == self._step and not result.failure:
            return
        self._step = result.step
        if result.failure:
            rospy.logerr("The scenario %s was given up: %s.", self._name, result.failure)
        else:
            rospy.loginfo("Scenario %s: %s", self._name, result.step)
        values = {"scenario": self._name, "step": result.step, "failure": result.failure}
        level = DiagnosticStatus.ERROR if result.failure else DiagnosticStatus.OK
        status = DiagnosticStatus(level=level, name="scenario", message=result.failure or result.step)
        status.values = [KeyValue(key, value) for key, value in values.items()]
        self._publisher.publish(status)

    def _take_flange(self, message: PoseStamped) -> None:
        T_base_flange = pose_from_message(message.pose)
        self._grip = (T_base_flange @ self._T_flange_tool)[:3, 3] + T_base_flange[:3, :3] @ GRIP_OFFSET

    def _take_mode(self, message: String) -> None:
        self._mode = message.data

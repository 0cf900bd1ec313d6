"""A scenario on the running rig: the observations, the actions and the progress of the simulated operator.

Publishes `simulation/scenario` (diagnostic_msgs/DiagnosticStatus, latched): its message is the present step, its values
are scenario, step, failure, and further ones of the scenario; its level is OK, or ERROR once the operator gave up.
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
from common.mounting import ToolConfig
from common.ros.conversions import pose_from_message
from rig_simulation.control_port import ControlClient
from rig_simulation.operator.pick_and_place import PickAndPlace, PickStep, PickView, Plan
from rig_simulation.world.scene import scene_from

PERIOD_S = 0.1
GRIP_OFFSET = (-0.0152, 0.0, 0.0)
"""From the tool point to the middle between fingers and thumb, in the flange's axes [m]: the hand's x axis is reversed
there, and its knuckles are at x = 60.4 mm and x = -30 mm."""

AT_HOME, FOLLOWING = "home", "servo"
LOST_S, AWAY_S, MOST_VISITS = 2.0, 2.0, 3
"""After a lost stream: delay until the operator reacts, time of the hand out of view, and most entries into view."""
TOPIC = "simulation/scenario"


class RigObserver:
    """The observations of an operator beside the rig.

    Args:
        name: of the scenario, for error messages.
        world: control port of the simulated world.

    Attributes:
        center_line: direction of the workspace, shape (3,).
        shapes: the objects of the scene, by name.
        R: orientation of the tool in the base, shape (3, 3); None before the first message.
        grip: gripping point of the tool, shape (3,) [m]; None before the first message.
        mode: of the arm's controller.

    Raises:
        RigError: the arm is not upright.
    """

    def __init__(self, name: str, world: ControlClient) -> None:
        self._world = world
        kuka = rospy.get_param("kuka")
        if any(kuka.get("mounting", [0.0])):
            raise RigError(f"The scenario {name} needs an upright arm; kuka/mounting is {kuka['mounting']}.")
        self._T_flange_tool = parse(ToolConfig, kuka, "kuka/", others=kuka).T_flange_tool
        self.center_line = np.asarray(kuka["center_line"], dtype=float)
        self.shapes = scene_from(world.ask("scene")["scene"]).objects
        self.R: np.ndarray | None = None
        self.grip: np.ndarray | None = None
        self.mode = ""
        rospy.Subscriber("simulation/flange", PoseStamped, self._take_flange, queue_size=1)
        rospy.Subscriber("kuka/mode", String, self._take_mode, queue_size=10)

    def objects(self) -> dict[str, dict]:
        """Returns the states of the objects, with `top`, the centre of the upper side, shape (3,) [m].

        Raises:
            DeviceError: the world does not answer.
        """
        found = self._world.ask("objects")["objects"]
        for name, seen in found.items():
            seen["top"] = np.add(seen["position"], (0.0, 0.0, self.shapes[name].height / 2.0))
        return found

    def _take_flange(self, message: PoseStamped) -> None:
        T_base_flange = pose_from_message(message.pose)
        T_base_tool = T_base_flange @ self._T_flange_tool
        self.R = T_base_tool[:3, :3]
        self.grip = T_base_tool[:3, 3] + T_base_flange[:3, :3] @ GRIP_OFFSET

    def _take_mode(self, message: String) -> None:
        self.mode = message.data


class ProgressReport:
    """Publishes the progress of a scenario when it changes.

    Args:
        name: of the scenario.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._published: dict[str, str] = {}
        self._publisher = rospy.Publisher(TOPIC, DiagnosticStatus, queue_size=10, latch=True)

    def publish(self, step: str, failure: str = "", **more: str) -> None:
        """Publishes step, failure and further values."""
        values = {"scenario": self._name, "step": step, "failure": failure, **more}
        if values == self._published:
            return
        if failure:
            rospy.logerr("The scenario %s failed: %s.", self._name, failure)
        elif step != self._published.get("step"):
            rospy.loginfo("Scenario %s: %s", self._name, step)
        self._published = values
        level = DiagnosticStatus.ERROR if failure else DiagnosticStatus.OK
        status = DiagnosticStatus(level=level, name="scenario", message=failure or step)
        status.values = [KeyValue(key, value) for key, value in values.items()]
        self._publisher.publish(status)


class PickScenario:
    """Picks one object up and puts it down.

    Args:
        name: of the scenario.
        thing: name of the object.
        leapd: control port of the simulated Leap service, which must run guided.
        world: control port of the simulated world.

    Raises:
        RigError: the arm is not upright, or the object is missing.
    """

    def __init__(self, name: str, thing: str, leapd: ControlClient, world: ControlClient) -> None:
        self._object, self._leapd = thing, leapd
        self._rig, self._report = RigObserver(name, world), ProgressReport(name)
        if thing not in self._rig.shapes:
            raise RigError(f"The scenario {name} needs an object {thing!r}; the scene has {sorted(self._rig.shapes)}.")

    def run(self) -> None:
        """Runs until the scenario is over or ROS shuts down, then takes the hand away.

        Raises:
            DeviceError: the world or the Leap service does not answer.
        """
        operator, visits, followed = self._come_in(), 1, None
        while not rospy.is_shutdown():
            time.sleep(PERIOD_S)
            if self._rig.grip is None:
                continue
            view, now = self._view(), time.monotonic()
            if view.following:
                followed = now
            elif followed is not None and now - followed > LOST_S and visits < MOST_VISITS:
                rospy.logwarn("The arm stopped following: the hand leaves the view, comes in again, and starts over.")
                self._leapd.ask("hide")
                time.sleep(AWAY_S)
                operator, visits, followed = self._come_in(), visits + 1, None
                continue
            result: PickStep = operator.step(view, now)
            if result.move is not None:
                self._leapd.ask("reach", **result.move.fields)
            self._report.publish(result.step, result.failure)
            if result.over:
                break
        self._leapd.ask("hide")

    def _come_in(self) -> PickAndPlace:
        self._leapd.ask("show")
        return PickAndPlace(Plan(), self._rig.center_line)

    def _view(self) -> PickView:
        seen = self._rig.objects()[self._object]
        return PickView(self._rig.grip, seen["top"], seen["clearance"], self._rig.mode == FOLLOWING)

"""An arm as the simulated operator sees it: where its tool is, what its controller does. Also the scenario's progress.
Publishes `simulation/scenario` (diagnostic_msgs/DiagnosticStatus, latched): its message is the present step, its values
are scenario, step, failure, and further ones of the scenario; its level is OK, or ERROR once the operator gave up."""

from __future__ import annotations

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String

from common.config import parse
from common.errors import RigError
from common.modes import Mode
from common.mounting import ToolConfig
from common.ros.conversions import pose_from_message
from common.teleop_record import teleop_record
from rig_msgs.msg import TeleopState
from rig_simulation.operator.steering import GRIP_OFFSET


class SeenArm:
    """The arm. `scenario`: whose progress is published; `arm`: its namespace, if there are several.

    Raises RigError if it is not upright.

    Attributes:
        R: orientation of the tool in the base, shape (3, 3); None before the first message.
        grip: gripping point of the tool in the base, shape (3,) [m]; likewise.
        mode: of the controller.
        streams: whether the tool follows the hand: not while it is held for it.
        center_line: direction of the workspace in the base, shape (3,)."""

    def __init__(self, scenario: str, arm: str = "") -> None:
        of = f"{arm}/" if arm else ""
        kuka = rospy.get_param(f"{of}kuka")
        if any(kuka.get("mounting", [0.0])):
            raise RigError(f"The scenario {scenario} needs an upright arm; kuka/mounting is {kuka['mounting']}.")
        self._T_flange_tool = parse(ToolConfig, kuka, f"{of}kuka/", others=kuka).T_flange_tool
        self.center_line = np.asarray(kuka["center_line"], dtype=float)
        self.R: np.ndarray | None = None
        self.grip: np.ndarray | None = None
        self.mode, self.streams = "", False
        self._scenario, self._whose = scenario, f"{arm}: " if arm else ""
        self._published: dict[str, str] = {}
        self._publisher = rospy.Publisher(f"{of}simulation/scenario", DiagnosticStatus, queue_size=10, latch=True)
        rospy.Subscriber(f"{of}simulation/flange", PoseStamped, self._take_flange, queue_size=1)
        rospy.Subscriber(f"{of}kuka/mode", String, self._take_mode, queue_size=10)
        rospy.Subscriber(f"{of}leap_kuka/state", TeleopState, self._take_teleop, queue_size=10)

    @property
    def following(self) -> bool:
        return self.mode == Mode.SERVO

    def tell(self, step: str, failure: str, **more: str) -> None:
        """Publishes the progress, if it is new."""
        values = {"scenario": self._scenario, "step": step, "failure": failure, **more}
        if values == self._published:
            return
        if failure:
            rospy.logerr("%sThe scenario %s failed: %s.", self._whose, self._scenario, failure)
        elif step != self._published.get("step"):
            rospy.loginfo("%sScenario %s: %s", self._whose, self._scenario, step)
        self._published = values
        level = DiagnosticStatus.ERROR if failure else DiagnosticStatus.OK
        status = DiagnosticStatus(level=level, name="scenario", message=failure or step)
        status.values = [KeyValue(key, value) for key, value in values.items()]
        self._publisher.publish(status)

    def _take_flange(self, message: PoseStamped) -> None:
        T_base_flange = pose_from_message(message.pose)
        T_base_tool = T_base_flange @ self._T_flange_tool
        self.R = T_base_tool[:3, :3]
        self.grip = T_base_tool[:3, 3] + T_base_flange[:3, :3] @ GRIP_OFFSET

    def _take_mode(self, message: String) -> None:
        self.mode = message.data

    def _take_teleop(self, message: TeleopState) -> None:
        self.streams = teleop_record(message).follows

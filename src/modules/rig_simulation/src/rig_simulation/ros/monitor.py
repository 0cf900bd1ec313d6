"""Publishes the true state of the simulated arm, which a real rig does not know, and offers its keys.

Topics: `simulation/flange` (pose of the flange in kuka/base_frame), `simulation/status` (stops, goals, mode, speed of
the tool: now, highest since the last status, highest since the start) [m/s].
Services: `simulation/release`, the run key after a safety stop; `simulation/back_off`, the jog keys, which move a
pressing arm back along its path.
"""

from __future__ import annotations

import time

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from std_srvs.srv import Trigger

from common.errors import DeviceError
from common.frames import BASE
from common.ros.params import private_config
from common.rotations import quaternion_from_rotation
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import MonitorConfig
from rig_simulation.ros.polling import poll, trigger

FLANGE_PERIOD_S = 0.01
STATUS_PERIOD_S = 0.1
TIMEOUT_S = 1.0
SHOWN = ("mode", "tcp_speed", "max_tcp_speed", "stops", "goals", "safety_stop", "connected")


class Monitor:
    """Polls the control port of the simulated controller and publishes its state."""

    def __init__(self, config: MonitorConfig) -> None:
        self._client = ControlClient(config.host, config.port, TIMEOUT_S)
        self._flange = rospy.Publisher("simulation/flange", PoseStamped, queue_size=10)
        self._status = rospy.Publisher("simulation/status", DiagnosticStatus, queue_size=10)
        self._next_status = 0.0
        self._peak_speed = 0.0
        released = "The safety stop is released; the arm resumes."
        rospy.Service("simulation/release", Trigger, trigger(self._client, "release", released))
        rospy.Service("simulation/back_off", Trigger, trigger(self._client, "back_off", "The arm backs off."))

    def run(self) -> None:
        """Polls until ROS shuts down; waits where the controller does not answer."""
        poll(self._publish, FLANGE_PERIOD_S)

    def _publish(self) -> None:
        try:
            state = self._client.ask("state")
        except DeviceError as error:
            self._publish_status(DiagnosticStatus.ERROR, str(error), {})
            raise
        flange = np.array(state["flange"])
        message = PoseStamped()
        message.header.frame_id = BASE
        message.header.stamp = rospy.Time.now() - rospy.Duration.from_sec(state["age"])
        message.pose = Pose(Point(*flange[:3, 3]), Quaternion(*quaternion_from_rotation(flange[:3, :3])))
        self._flange.publish(message)
        self._peak_speed = max(self._peak_speed, state["tcp_speed"])
        if time.monotonic() >= self._next_status:
            self._next_status = time.monotonic() + STATUS_PERIOD_S
            stop = state["safety_stop"]
            self._publish_status(
                DiagnosticStatus.WARN if stop else DiagnosticStatus.OK,
                stop or "The arm is ready.",
                {**{name: state[name] for name in SHOWN}, "peak_tcp_speed": self._peak_speed},
            )
            self._peak_speed = 0.0

    def _publish_status(self, level: int, message: str, values: dict) -> None:
        texts = [KeyValue(name, "" if value is None else str(value)) for name, value in values.items()]
        self._status.publish(DiagnosticStatus(level=level, name="simulation", message=message, values=texts))


def main() -> None:
    """Runs the node with its private parameters."""
    Monitor(private_config(MonitorConfig)).run()

"""Publishes the truth about the simulated arm, which no real rig knows, and offers its keys.

Topics: `simulation/flange` (pose of the flange in kuka/base_frame), `simulation/status` (stops, goals, mode, speed of
the tool: now, at most since the last status, at most since the controller started) [m/s].
Services: `simulation/release`, the key "run" after a safety stop; `simulation/back_off`, the jog keys, which move an
arm that presses on something back on the way it came.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse

from common.errors import DeviceError
from common.frames import BASE
from common.ros.params import private_config
from common.rotations import quaternion_from_rotation
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import MonitorConfig
from rig_simulation.ros.polling import poll

FLANGE_PERIOD_S = 0.01
STATUS_PERIOD_S = 0.1
TIMEOUT_S = 1.0
SHOWN = ("mode", "tcp_speed", "max_tcp_speed", "stops", "goals", "safety_stop", "connected")


class Monitor:
    """Polls the control port of the simulated controller and publishes what it says."""

    def __init__(self, config: MonitorConfig) -> None:
        self._client = ControlClient(config.host, config.port, TIMEOUT_S)
        self._flange = rospy.Publisher("simulation/flange", PoseStamped, queue_size=10)
        self._status = rospy.Publisher("simulation/status", DiagnosticStatus, queue_size=10)
        self._next_status = 0.0
        self._peak_speed = 0.0
        rospy.Service(
            "simulation/release", Trigger, self._key("release", "The safety stop is released; the arm goes on.")
        )
        rospy.Service("simulation/back_off", Trigger, self._key("back_off", "The arm backs off."))

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

    def _key(self, request: str, done: str) -> Callable[[TriggerRequest], TriggerResponse]:
        def press(_: TriggerRequest) -> TriggerResponse:
            try:
                self._client.ask(request)
            except DeviceError as error:
                return TriggerResponse(False, str(error))
            return TriggerResponse(True, done)

        return press


def main() -> None:
    """Runs the node with its private parameters."""
    Monitor(private_config(MonitorConfig)).run()

"""Publishes the poses of the objects in the simulated world, and changes the scene.

Topics: `simulation/object_states` in kuka/base_frame; on /diagnostics the real-time factor of the world. Services:
`simulation/reset` puts the objects back to their poses of the scene, `simulation/set_scene` loads another scene; arm
and hand keep their state.
"""

from __future__ import annotations

import time

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Pose, Quaternion
from std_srvs.srv import Trigger

from common.errors import DeviceError
from common.frames import BASE
from common.ros.diagnostics import Diagnostics
from common.ros.params import private_config
from common.rotations import quaternion_from_rotation, rotation_from_quaternion, rotation_from_zyx
from rig_msgs.msg import ObjectState, ObjectStates
from rig_msgs.srv import SetScene, SetSceneRequest, SetSceneResponse
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import WorldMonitorConfig
from rig_simulation.ros.polling import poll, trigger
from rig_simulation.world.pace import Pace

NAME = "world_monitor"
TIMEOUT_S = 2.0
STATE_PERIOD_S = 0.5
SLOW = 0.95
"""Fraction of the desired speed below which the world counts as slow."""


class WorldMonitor:
    """Polls the control port of the simulated world and publishes its state."""

    def __init__(self, config: WorldMonitorConfig) -> None:
        self._period = 1.0 / config.rate
        self._client = ControlClient(config.host, config.port, TIMEOUT_S)
        self._pace, self._next_state = Pace(), 0.0
        self._state: dict | None = None
        self._trouble = f"The simulated world at {config.host}:{config.port} has not answered yet."
        self._objects = rospy.Publisher("simulation/object_states", ObjectStates, queue_size=10)
        reset = trigger(self._client, "reset", "The objects are back in their poses of the scene.")
        rospy.Service("simulation/reset", Trigger, reset)
        rospy.Service("simulation/set_scene", SetScene, self._set_scene)
        Diagnostics("simulated_world", self._diagnose)

    def run(self) -> None:
        """Polls until ROS shuts down; waits where the world does not answer."""
        poll(self._publish, self._period)

    def _publish(self) -> None:
        try:
            answer = self._client.ask("objects")
            self._take_state()
        except DeviceError as error:
            self._trouble = str(error)
            raise
        self._trouble = ""
        roll, pitch, yaw = np.radians(answer["mounting"])
        R_base_world = rotation_from_zyx(yaw, pitch, roll).T
        message = ObjectStates()
        message.header.frame_id = BASE
        message.header.stamp = rospy.Time.now()
        for name, state in answer["objects"].items():
            R = R_base_world @ rotation_from_quaternion(state["quaternion"])
            position = Point(*(R_base_world @ state["position"]))
            pose = Pose(position, Quaternion(*quaternion_from_rotation(R)))
            message.objects.append(ObjectState(name, pose, state["clearance"], state["speed"], state["touches"]))
        self._objects.publish(message)

    def _take_state(self) -> None:
        now = time.monotonic()
        if now < self._next_state:
            return
        self._next_state = now + STATE_PERIOD_S
        state = self._client.ask("state")
        now = time.monotonic()
        self._pace.add(state["time"], now)
        self._state = {"world_s": state["time"], "wall_s": now, "speed": state["speed"], "contacts": state["contacts"]}

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        state, factor = self._state, self._pace.factor
        if self._trouble or state is None:
            return DiagnosticStatus.ERROR, self._trouble, {}
        values = {name: "" if value is None else value for name, value in state.items()}
        values["real_time_factor"] = "" if factor is None else f"{factor:.3f}"
        if factor is not None and state["speed"] is not None and factor < SLOW * state["speed"]:
            return (
                DiagnosticStatus.WARN,
                f"Too slow: {factor:.2f} s of the world in a second; close other programs.",
                values,
            )
        return DiagnosticStatus.OK, "The world runs in real time.", values

    def _set_scene(self, request: SetSceneRequest) -> SetSceneResponse:
        try:
            self._client.ask("set_scene", scene=request.scene)
        except DeviceError as error:
            return SetSceneResponse(False, str(error))
        return SetSceneResponse(True, f"The scene is {request.scene}.")


def main() -> None:
    """Runs the node with its private parameters."""
    WorldMonitor(private_config(WorldMonitorConfig)).run()

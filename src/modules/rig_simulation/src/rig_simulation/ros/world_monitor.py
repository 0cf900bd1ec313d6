"""Publishes where the objects of the simulated world are, and changes what stands there.

Topic: `simulation/object_states` in kuka/base_frame. Services: `simulation/reset` puts the objects back to where the
scene wants them, `simulation/set_scene` puts another scene there; arm and hand stay as they are.
"""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion
from std_srvs.srv import Trigger, TriggerResponse

from common.errors import DeviceError
from common.ros.params import private_config
from common.rotations import quaternion_from_rotation, rotation_from_quaternion, rotation_from_zyx
from rig_msgs.msg import ObjectState, ObjectStates
from rig_msgs.srv import SetScene, SetSceneRequest, SetSceneResponse
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import WorldMonitorConfig
from rig_simulation.ros.polling import poll

NAME = "world_monitor"
BASE_FRAME = "kuka/base_frame"
TIMEOUT_S = 2.0


class WorldMonitor:
    """Polls the control port of the simulated world and publishes what it says."""

    def __init__(self, config: WorldMonitorConfig) -> None:
        self._period = 1.0 / config.rate
        self._client = ControlClient(config.host, config.port, TIMEOUT_S)
        self._objects = rospy.Publisher("simulation/object_states", ObjectStates, queue_size=10)
        rospy.Service("simulation/reset", Trigger, self._reset)
        rospy.Service("simulation/set_scene", SetScene, self._set_scene)

    def run(self) -> None:
        """Polls until ROS shuts down; waits where the world does not answer."""
        poll(self._publish, self._period)

    def _publish(self) -> None:
        answer = self._client.ask("objects")
        roll, pitch, yaw = np.radians(answer["mounting"])
        R_base_world = rotation_from_zyx(yaw, pitch, roll).T
        message = ObjectStates()
        message.header.frame_id = BASE_FRAME
        message.header.stamp = rospy.Time.now()
        for name, state in answer["objects"].items():
            R = R_base_world @ rotation_from_quaternion(state["quaternion"])
            position = Point(*(R_base_world @ state["position"]))
            pose = Pose(position, Quaternion(*quaternion_from_rotation(R)))
            message.objects.append(ObjectState(name, pose, state["clearance"], state["speed"], state["touches"]))
        self._objects.publish(message)

    def _reset(self, _) -> TriggerResponse:
        try:
            self._client.ask("reset")
        except DeviceError as error:
            return TriggerResponse(False, str(error))
        return TriggerResponse(True, "The objects are back in their places.")

    def _set_scene(self, request: SetSceneRequest) -> SetSceneResponse:
        try:
            self._client.ask("set_scene", scene=request.scene)
        except DeviceError as error:
            return SetSceneResponse(False, str(error))
        return SetSceneResponse(True, f"The scene is {request.scene}.")


def main() -> None:
    """Runs the node with its private parameters."""
    WorldMonitor(private_config(WorldMonitorConfig)).run()

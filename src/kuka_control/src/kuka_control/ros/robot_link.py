"""The connection of a controller to the robot: made at the start, made again after it was lost, closed at the end."""

from __future__ import annotations

import time
from functools import partial

import rospy

from common.errors import DeviceError
from kst import KstClient, KstError, NoServer
from kuka_control.loop.arm import KstArm
from kuka_control.model.config import ControllerConfig
from kuka_control.model.rig import Rig
from kuka_control.model.wrench import wrench_at_tool

PATIENCE_S = 20.0
RETRY_S = 0.5
TIMEOUT_S = 5.0
AGAIN_TIMEOUT_S = 2.0
"""How long a try to connect again waits for the connection, and again for the first answer [s]."""

SHUTDOWN_S = 0.5
"""A lost connection is no fault if ROS is to shut down within this time [s]."""


class RobotLink:
    """Holds the connection.

    A server that is not there yet at the start, because it is started at the same time, is tried again for a while.

    Attributes:
        arm: the robot.

    Raises:
        DeviceError: there is no connection.
    """

    def __init__(self, config: ControllerConfig, rig: Rig) -> None:
        self._config, self._rig = config, rig
        rospy.loginfo("Connecting to the robot at %s:%d.", config.ip, config.port)
        self.arm = self._first()

    def close(self) -> None:
        """Leaves servo mode and closes the connection; never raises."""
        self.arm.close()

    def again(self) -> None:
        """Tries once to connect; `arm` is another one then.

        Raises:
            KstError: it did not succeed.
        """
        self.arm = self._connected(AGAIN_TIMEOUT_S)

    def _first(self) -> KstArm:
        config, waiting = self._config, False
        deadline = time.monotonic() + PATIENCE_S
        while not rospy.is_shutdown():
            try:
                return self._connected(TIMEOUT_S)
            except KstError as error:
                if not isinstance(error, NoServer) or time.monotonic() > deadline:
                    if ends_soon():
                        break
                    sentence = f"There is no connection to the robot at {config.ip}:{config.port}: {error}."
                    raise DeviceError(sentence) from error
                if not waiting:
                    rospy.logwarn("%s. Trying for %g s.", error, PATIENCE_S)
                waiting = True
                time.sleep(RETRY_S)
        raise rospy.ROSInterruptException("shut down while connecting")

    def _connected(self, timeout: float) -> KstArm:
        config, rig = self._config, self._rig
        client = KstClient.connect(config.ip, config.port, tool=rig.T_flange_tool, timeout=timeout)
        try:
            return KstArm(client, partial(wrench_at_tool, rig.kinematics))
        except KstError:
            client.close()
            raise


def ends_soon() -> bool:
    """Returns whether ROS shuts down: when all is ended at once, the robot's controller may be gone a moment before."""
    deadline = time.monotonic() + SHUTDOWN_S
    while not rospy.core.is_shutdown_requested() and not rospy.is_shutdown():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True

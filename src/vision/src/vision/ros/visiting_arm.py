"""The arm on its way from view to view, or moved by somebody else, over the toolbox's server, which serves one program
at a time.

While it has the arm it also publishes joints and flange as the arm's controllers do otherwise.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import JointState

from common.config import choice, integer, parse, text
from common.errors import ConfigError, DeviceError
from common.frames import BASE, FLANGE_MEASURED
from common.mounting import mounting_field
from common.ros.conversions import stamped_transform
from common.ros.nodes import listens
from kst.client import KstClient
from kst.errors import ReplyTimeout, ServerBusy
from kst.limits import JointLimits
from rig_description.arms import ARMS, MEDIA_FLANGES
from vision.calibration.arm_model import JOINTS, ArmModel
from vision.ros.calibration.store import StoreConfig

CONTROLLERS = ("kuka_real_time_node", "kuka_ptp_node", "kuka_simple_node")
DEFAULT_PORT = 30001
PERIOD_S = 0.1
MOVED_RAD = np.radians(0.02)
STALLED_S, GIVEN_UP_S = 3.0, 60.0
MAX_MISSED = 5
ARRIVED_RAD = np.radians(0.2)


@dataclass(frozen=True)
class RobotAddress:
    """Which arm, how it is mounted, and where its server listens; the names are those of the parameters under kuka/."""

    robot: str = choice(*ARMS, doc="the arm")
    flange: str = choice(*MEDIA_FLANGES, doc="its media flange")
    ip: str = text(doc="address of the robot's controller")
    port: int = integer(low=1, high=65535, doc="TCP port of the toolbox server")
    mounting: np.ndarray = mounting_field()

    @property
    def attitude(self) -> str:
        """How the base stands, as a part of a sentence."""
        if not self.mounting.any():
            return "base upright"
        roll, pitch, yaw = self.mounting
        return f"base turned by roll {roll:g}, pitch {pitch:g}, yaw {yaw:g} deg against the upright world"


def robot_address(store: StoreConfig, given: dict) -> RobotAddress:
    """Returns the robot of the parameters under kuka/, else that of the store, changed by what is given and not None.

    Raises:
        ConfigError: with all faults.
    """
    values = {"robot": store.robot, "flange": store.flange, "port": DEFAULT_PORT, **rospy.get_param("kuka", {})}
    values.update({key: value for key, value in given.items() if value is not None})
    known = {key: values[key] for key in ("robot", "flange", "ip", "port", "mounting") if key in values}
    address = parse(RobotAddress, known, prefix="kuka/")
    if (address.robot, address.flange) != (store.robot, store.flange):
        raise ConfigError(
            [
                f"The arm is {address.robot} with {address.flange}, but camera_apriltag.launch was started for "
                f"{store.robot} with {store.flange}: give it the arguments robot and flange."
            ]
        )
    return address


class VisitingArm:
    """Moves the arm from point to point, and tells where it is.

    Args:
        address: of its server.
        model: of the arm.
        velocity: share of full joint speed.

    Raises:
        DeviceError: a controller node has the robot, or it does not answer.
    """

    def __init__(self, address: RobotAddress, model: ArmModel, velocity: float) -> None:
        _refuse_if_held()
        self._velocity = velocity
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self._joint_states = rospy.Publisher("joint_states", JointState, queue_size=10)
        limits = JointLimits(model.lower, model.upper)
        try:
            self._client = KstClient.connect(address.ip, address.port, limits=limits)
        except ServerBusy as error:
            raise DeviceError(
                f"The robot serves one program at a time, and another seems to have it: {error}"
            ) from error
        except DeviceError as error:
            raise DeviceError(f"There is no connection to the robot: {error}.") from error
        self._model = model
        self._publish(self.joints())

    def joints(self) -> np.ndarray:
        """Returns the measured joints, shape (7,) [rad]."""
        return self._client.joints()

    def flange(self) -> np.ndarray:
        """Returns T_base_flange, shape (4, 4) [m], as the arm measures it at rest."""
        T = self._client.pose()
        self._broadcaster.sendTransform(stamped_transform(T, BASE, FLANGE_MEASURED, rospy.Time.now()))
        return T

    def go(self, q: np.ndarray, tell: Callable[[str], None]) -> None:
        """Moves to q, shape (7,) [rad], and returns when it is there.

        Args:
            tell: takes a sentence when the arm does not move.

        Raises:
            DeviceError: the robot refuses or gives up the motion, does not answer, or stands still for too long.
        """
        self._client.start_ptp_joints(q, self._velocity)
        last, moved_at, missed, told = self.joints(), time.monotonic(), 0, False
        while True:
            try:
                arrived, joints = self._client.ptp_arrived(), self._client.joints()
                missed = 0
            except ReplyTimeout:
                missed += 1
                if missed == MAX_MISSED:
                    raise
                continue
            self._publish(joints)
            if arrived:
                break
            if np.max(np.abs(joints - last)) > MOVED_RAD:
                last, moved_at, told = joints, time.monotonic(), False
            still = time.monotonic() - moved_at
            if still > GIVEN_UP_S:
                raise DeviceError(f"The arm has not moved for {still:.0f} s; end the server on the smartPad.")
            if still > STALLED_S and not told:
                told = True
                tell("The arm does not move: look at the smartPad (enabling switch, safety stop, speed override).")
            time.sleep(PERIOD_S)
        left = float(np.max(np.abs(self.joints() - q)))
        if left > ARRIVED_RAD:
            raise DeviceError(f"The motion ended {np.degrees(left):.1f} deg before its goal; look at the smartPad.")

    def close(self) -> None:
        """Ends the connection; never raises."""
        self._client.close()

    def _publish(self, joints: np.ndarray) -> None:
        now = rospy.Time.now()
        message = JointState(name=JOINTS, position=joints.tolist())
        message.header.stamp = now
        self._joint_states.publish(message)
        self._broadcaster.sendTransform(stamped_transform(self._model.flange(joints), BASE, FLANGE_MEASURED, now))


def _refuse_if_held() -> None:
    master = rospy.get_master()
    for name in CONTROLLERS:
        code, _, uri = master.lookupNode(rospy.resolve_name(name))
        if code == 1 and listens(uri):
            raise DeviceError(
                f"The node {name} has the robot's only connection; end it first (rosservice call kuka/exit_app), "
                "or move the arm with it and use --by-hand without --ip."
            )

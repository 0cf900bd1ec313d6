"""The arm that moves from view to view over the toolbox's server, which serves one program at a time."""

from __future__ import annotations

import contextlib
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import JointState

from common.config import choice, integer, parse, text
from common.errors import ConfigError, DeviceError
from common.frames import BASE, FLANGE_MEASURED
from common.mounting import mounting_field
from common.ros.conversions import stamped_transform
from common.ros.service_calls import listens
from iiwa_kinematics import FLANGE_HEIGHTS, ROBOTS, ptp_velocity, robot_model
from kst import JointLimits, KstClient, KstError, PtpLimits, PtpProgress, ServerBusy, read_joints, run_ptp
from rig_description.hand import CONNECTOR_LENGTH, RING_LENGTH, finger_balls
from vision.calibration.arm_model import JOINTS, ArmModel
from vision.ros.calibration.calibration_setup import StoreConfig

CONTROLLERS = ("kuka_real_time_node", "kuka_ptp_node", "kuka_simple_node")
FINGERS = finger_balls(CONNECTOR_LENGTH + RING_LENGTH)  # as far as they reach the speed is limited, whatever is mounted
LIMITS = PtpLimits(arrived=np.radians(0.2))


@dataclass(frozen=True)
class ArmAddress:
    """The arm, its mounting, and the address of its server; the names are those of the parameters under kuka/."""

    robot: str = choice(*ROBOTS, doc="the arm")
    flange: str = choice(*FLANGE_HEIGHTS, doc="its media flange")
    ip: str = text(doc="address of the robot's controller")
    port: int = integer(low=1, high=65535, doc="TCP port of the toolbox server")
    mounting: np.ndarray = mounting_field()


def arm_address(store: StoreConfig, options: Namespace) -> ArmAddress:
    """Returns the robot under kuka/, else the store's; options override it. Raises ConfigError with all faults."""
    default_port = 30001
    values = {"robot": store.robot, "flange": store.flange, "port": default_port, **rospy.get_param("kuka", {})}
    values.update({key: value for key, value in vars(options).items() if value is not None})
    names = [field.name for field in fields(ArmAddress)]
    address = parse(ArmAddress, {key: values[key] for key in names if key in values}, prefix="kuka/")
    if (address.robot, address.flange) != (store.robot, store.flange):
        fault = (
            f"The arm is {address.robot} with {address.flange}, but camera_apriltag.launch was started for "
            f"{store.robot} with {store.flange}: give it the arguments robot and flange."
        )
        raise ConfigError([fault])
    return address


class PtpArm:
    """Moves the arm with a fraction of full joint speed, (0, 1]; publishes joints and flange, as its controllers do.
    Every call raises DeviceError if the robot does not answer or refuses; so does the constructor, also if a controller
    node has the robot."""

    def __init__(self, address: ArmAddress, model: ArmModel, velocity: float) -> None:
        master = rospy.get_master()
        for name in CONTROLLERS:
            code, _, uri = master.lookupNode(rospy.resolve_name(name))
            if code == 1 and listens(uri):
                raise DeviceError(
                    f"The node {name} has the robot's only connection; stop it first (rosservice call kuka/exit_app), "
                    "or move the arm with it and use --by-hand without --ip."
                )
        self._velocity = velocity
        self._model = model
        self._robot = robot_model(address.robot, address.flange)
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self._joint_states = rospy.Publisher("joint_states", JointState, queue_size=10)
        limits = JointLimits(model.lower, model.upper)
        try:
            self._client = KstClient.connect(address.ip, address.port, limits=limits)
        except ServerBusy as error:
            raise DeviceError(f"The robot serves one program at a time, and another one has it: {error}.") from error
        except KstError as error:
            raise DeviceError(f"There is no connection to the robot: {error}.") from error
        self._publish(self.joints())

    def joints(self) -> np.ndarray:
        """Returns the measured joints, shape (7,) [rad]."""
        with _device_errors():
            return read_joints(self._client)

    def flange(self) -> np.ndarray:
        """Returns T_base_flange, shape (4, 4) [m], as the arm measures it at rest."""
        with _device_errors():
            T = self._client.pose()
        self._broadcaster.sendTransform(stamped_transform(T, BASE, FLANGE_MEASURED, rospy.Time.now()))
        return T

    def move_to(self, q: np.ndarray) -> None:
        """Moves to q, shape (7,) [rad], and returns on arrival; prints a sentence while the arm is stalled. It is
        slower than the given fraction where a point from elbow to finger tips would pass `PTP_M_PER_S`."""
        with _device_errors():
            velocity = ptp_velocity(self._robot, FINGERS, read_joints(self._client), q, self._velocity)
            run_ptp(self._client, q, velocity, LIMITS, self._report)

    def close(self) -> None:
        """Closes the connection and tells the operator; never raises."""
        self._client.close()
        print("The connection is closed, and with it the server on the robot; restart it there for the next program.")

    def _report(self, progress: PtpProgress, joints: np.ndarray) -> None:
        self._publish(joints)
        if progress.stall_began:
            print("The arm does not move: look at the smartPad (enabling switch, safety stop, speed override).")

    def _publish(self, joints: np.ndarray) -> None:
        now = rospy.Time.now()
        message = JointState(name=JOINTS, position=joints.tolist())
        message.header.stamp = now
        self._joint_states.publish(message)
        self._broadcaster.sendTransform(stamped_transform(self._model.flange(joints), BASE, FLANGE_MEASURED, now))


@contextlib.contextmanager
def _device_errors() -> Iterator[None]:
    """Turns an error of the toolbox's client into a DeviceError."""
    try:
        yield
    except KstError as error:
        raise DeviceError(f"The robot: {error}.") from error

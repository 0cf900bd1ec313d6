"""The node reflex_takktile_driver: readings become messages; commands and services become calls of the hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_srvs.srv import Empty

from common import clock
from common.errors import ConfigError, DeviceError
from common.ros.diagnostics import Diagnostics
from common.ros.node import while_running
from common.ros.params import wait_for_config
from common.ros.publishing import DirectPublisher
from common.ros.simulated_devices import SimulatedDevices
from common.simulated import WITHOUT_HARDWARE
from reflex.calibration_files import CalibrationFiles
from reflex.client import ReflexHand
from reflex.errors import CalibrationFileError, CommandRefused, ReflexError
from reflex.motion import HandNote
from reflex.reading import JOINT_NAMES, HandReading, joint_positions
from reflex.ros.parameters import HandAddresses, ReflexDriverConfig
from reflex.transport import LOOPBACK
from reflex_msgs.msg import Finger, Hand, Motor, RadianServoCommands, RawServoCommands
from reflex_msgs.srv import SetSpeed, SetTactileThreshold

LOG = {"info": rospy.loginfo, "warning": rospy.logwarn, "error": rospy.logerr}
LEVELS = {"ok": DiagnosticStatus.OK, "warning": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


class HandDriver:
    """The hand on its topics and services."""

    def __init__(self, config: HandAddresses) -> None:
        self._hand_state = DirectPublisher("reflex_takktile/hand_state", Hand, queue_size=10)
        self._joint_states = DirectPublisher("joint_states", JointState, queue_size=10)
        shipped = Path(rospkg.RosPack().get_path("reflex")) / "config"
        interface, port = config.network_interface, config.port
        files = CalibrationFiles(config.calibration_folder, shipped, simulated=interface == LOOPBACK)
        self._real_and_unheard = interface != LOOPBACK
        self._beside = SimulatedDevices(f"hand on {interface}") if interface != LOOPBACK else None
        hooks = (self._publish, self._say)
        self._hand = ReflexHand(
            interface, port, config.settings(), files, *hooks, hold_at_exit=config.hold_at_exit, runtime=clock
        )
        rospy.loginfo("Calibrations are kept in %s.", files.folder)
        rospy.loginfo("Listening for the hand on %s, port %d.", interface, port)
        Diagnostics("reflex", self._diagnosis)

    def run(self) -> None:
        """Runs until ROS shuts down; leaves the hand idle, or holding."""
        poll_s = 0.1
        try:
            if self._beside is not None:
                self._beside.refuse()
            self._hand.connect()
            rospy.on_shutdown(self._hand.disconnect)
            self._offer()
            while not rospy.is_shutdown():
                if not self._hand.listening and not rospy.core.is_shutdown_requested():  # which ends the thread
                    raise RuntimeError("the receive thread of the hand ended; its traceback is above")
                if self._beside is not None:
                    self._beside.check()
                clock.sleep(poll_s)
        finally:
            self._hand.disconnect()

    def _offer(self) -> None:
        hand = self._hand
        self._subscribe("radian_hand_command", RadianServoCommands, lambda m: hand.command(m.radian_commands))
        self._subscribe("raw_hand_command", RawServoCommands, lambda m: hand.command_raw(m.raw_positions))
        self._serve("set_speed", SetSpeed, lambda r: hand.set_speed(r.motor))
        self._serve("calibrate_fingers", Empty, lambda _: hand.calibrate_fingers(wait=False))
        self._serve("calibrate_tactile", Empty, lambda _: hand.calibrate_tactile())
        self._serve("zero_pose", Empty, lambda _: hand.zero_pose())
        self._serve("disable_torque", Empty, lambda _: hand.disable_torque())
        self._serve("set_tactile_threshold", SetTactileThreshold, self._set_thresholds)

    @staticmethod
    def _subscribe(name: str, message_type: type, send: Callable) -> None:
        remind_s = 5.0

        def take(message: object) -> None:
            try:
                send(message)
            except CommandRefused as error:
                rospy.logwarn_throttle_identical(remind_s, f"Command refused: {error}")

        rospy.Subscriber(f"reflex_takktile/{name}", message_type, take, queue_size=10)

    @staticmethod
    def _serve(name: str, service_type: type, call: Callable) -> None:
        def handle(request: object) -> object:
            try:
                call(request)
            except CommandRefused as error:
                raise rospy.ServiceException(str(error)) from error
            return service_type._response_class()

        rospy.Service(f"reflex_takktile/{name}", service_type, handle)

    def _publish(self, reading: HandReading) -> None:
        self._real_and_unheard = False
        with while_running():
            self._hand_state.publish(hand_message(reading))
            joints = JointState(name=list(JOINT_NAMES), position=list(joint_positions(reading)))
            joints.header.stamp = rospy.Time.now()
            self._joint_states.publish(joints)

    def _set_thresholds(self, request: object) -> None:
        self._hand.set_thresholds([finger.sensor for finger in request.finger])

    def _say(self, note: HandNote) -> None:
        unanswered = self._real_and_unheard and note.level == "warning"
        LOG[note.level](f"{note.text} {WITHOUT_HARDWARE}" if unanswered else note.text)

    def _diagnosis(self) -> tuple[int, str, dict[str, object]]:
        level, sentence, values = self._hand.diagnosis()
        return LEVELS[level], sentence, values


def hand_message(reading: HandReading) -> Hand:
    fingers = [
        Finger(
            proximal=reading.proximal[i],
            distal_approx=reading.distal[i],
            contact=list(reading.contact[i]),
            pressure=[float(p) for p in reading.pressure[i]],
        )
        for i in range(3)
    ]
    packet = reading.packet
    motors = [
        Motor(
            joint_angle=reading.joint_angles[i],
            raw_angle=packet.positions[i],
            velocity=packet.speeds[i],
            load=reading.loads[i],
            voltage=packet.voltages[i],
            temperature=packet.temperatures[i],
            error_state=f"0x{packet.errors[i]:02x}",
        )
        for i in range(4)
    ]
    return Hand(finger=fingers, motor=motors)


def main() -> None:
    """Reads the private parameters and drives the hand until ROS shuts down; raises ConfigError if a parameter or a
    calibration file is wrong, DeviceError if the network interface or the port cannot be used."""
    config = wait_for_config(ReflexDriverConfig, rospy.get_name())
    try:
        HandDriver(config).run()
    except CalibrationFileError as error:
        raise ConfigError(error.faults) from error
    except ReflexError as error:
        hint = "" if config.network_interface == LOOPBACK else f" {WITHOUT_HARDWARE}"
        raise DeviceError(f"{error}{hint}") from error

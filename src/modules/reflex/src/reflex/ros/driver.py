"""Node: the driver of the hand. Packets become messages; commands and services become packets."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_srvs.srv import Empty, EmptyResponse

from common.errors import DeviceError
from common.ros.diagnostics import Diagnostics
from common.ros.params import wait_for_config
from reflex.hand import Hand, Result, State
from reflex.ros.calibration_files import CalibrationFiles
from reflex.ros.messages import hand_message, joint_state
from reflex.settings import Settings
from reflex.status import status
from reflex.transport import Transport
from reflex_msgs.msg import Hand as HandMessage
from reflex_msgs.msg import RadianServoCommands, RawServoCommands
from reflex_msgs.srv import SetSpeed, SetSpeedResponse, SetTactileThreshold, SetTactileThresholdResponse

RECEIVE_TIMEOUT_S = 0.005
SPEED_TIMEOUT_S = 2.0
REMIND_S = 5.0
REOPEN_S = 2.0


class Driver:
    """Joins the hand's state machine with its sockets, its files and ROS."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._transport = Transport(settings.network_interface, settings.port)
        self._files = CalibrationFiles(settings.calibration_folder)
        self._hand = Hand(settings, *self._files.load())
        # Reentrant: ROS ends the node from a signal handler, in whatever the main thread is doing.
        self._lock = threading.RLock()
        self._stopped = False
        self._wire_fault = ""
        self._reopen_time = time.monotonic() + REOPEN_S
        self._hand_state = rospy.Publisher("/reflex_takktile/hand_state", HandMessage, queue_size=10)
        self._joint_states = rospy.Publisher("joint_states", JointState, queue_size=10)
        Diagnostics("reflex", self._status)

    def run(self) -> None:
        """Runs until ROS shuts down; leaves the hand idle."""
        rospy.loginfo("Listening for the hand on %s, port %d.", self._settings.network_interface, self._settings.port)
        rospy.on_shutdown(self._stop)
        try:
            self._act(lambda now: self._hand.start())
            self._offer()
            while not rospy.is_shutdown():
                self._take_in()
                self._act(self._hand.tick)
                self._watch_silence()
        finally:
            self._stop()
            self._transport.close()

    def _stop(self) -> None:
        """Leaves the hand idle; nothing is sent after that."""
        with self._lock:
            if not self._stopped:
                self._act(lambda now: self._hand.stop())
                self._stopped = True

    def _offer(self) -> None:
        rospy.Subscriber("/reflex_takktile/radian_hand_command", RadianServoCommands, self._radians, queue_size=10)
        rospy.Subscriber("/reflex_takktile/raw_hand_command", RawServoCommands, self._raw, queue_size=10)
        rospy.Service("/reflex_takktile/set_speed", SetSpeed, self._set_speed)
        rospy.Service("/reflex_takktile/set_tactile_threshold", SetTactileThreshold, self._set_threshold)
        for name, request in {
            "calibrate_fingers": self._hand.calibrate_fingers,
            "calibrate_tactile": self._hand.calibrate_tactile,
            "zero_pose": self._hand.zero_pose,
            "disable_torque": lambda now: self._hand.disable_torque(),
        }.items():
            rospy.Service(f"/reflex_takktile/{name}", Empty, lambda _, request=request: self._request(request))

    def _take_in(self) -> None:
        try:
            datagram = self._transport.receive(RECEIVE_TIMEOUT_S)
        except DeviceError as error:
            self._wire_failed(error)
            return
        if datagram is None:
            return
        result = self._act(lambda now: self._hand.receive(*datagram, now))
        if result.reading:
            self._hand_state.publish(hand_message(result.reading))
            self._joint_states.publish(joint_state(result.reading, rospy.Time.now()))
        self._save(result)

    def _act(self, step: Callable[[float], Result]) -> Result:
        """Lets the hand do a step and sends what comes of it, in order, whichever thread asks."""
        with self._lock:
            result = step(time.monotonic())
            for packet in () if self._stopped else result.send:
                try:
                    self._transport.send(packet)
                    self._wire_fault = ""
                except DeviceError as error:
                    self._wire_failed(error)
        for note in () if self._stopped else result.notes:
            {"info": rospy.loginfo, "warning": rospy.logwarn, "error": rospy.logerr}[note.level](note.text)
        return result

    def _wire_failed(self, error: DeviceError) -> None:
        if str(error) != self._wire_fault:
            self._wire_fault = str(error)
            rospy.logerr(str(error))

    def _watch_silence(self) -> None:
        """While the hand is silent, opens the sockets anew: a cable or an address may have come after the start."""
        now = time.monotonic()
        if self._hand.link.age(now) < REOPEN_S or now < self._reopen_time:
            return
        self._reopen_time = now + REOPEN_S
        rospy.logwarn_throttle(
            REMIND_S, f"No packet from the hand on {self._settings.network_interface}: is it on and its cable in?"
        )
        try:
            fresh = Transport(self._settings.network_interface, self._settings.port)
        except DeviceError as error:
            self._wire_failed(error)
            return
        with self._lock:
            old, self._transport = self._transport, fresh
        old.close()

    def _save(self, result: Result) -> None:
        for save, value in ((self._files.save_zeros, result.zeros), (self._files.save_offsets, result.offsets)):
            if value is None:
                continue
            try:
                rospy.loginfo("Calibration saved in %s.", save(value))
            except DeviceError as error:
                rospy.logerr(str(error))

    def _radians(self, message: RadianServoCommands) -> None:
        self._command(lambda now: self._hand.command(message.radian_commands, now))

    def _raw(self, message: RawServoCommands) -> None:
        self._command(lambda now: self._hand.command_raw(message.raw_positions, now))

    def _command(self, step: Callable[[float], Result]) -> None:
        refusal = self._act(step).refusal
        if refusal:
            rospy.logwarn_throttle_identical(REMIND_S, f"Command refused: {refusal}")

    def _request(self, step: Callable[[float], Result]) -> EmptyResponse:
        refusal = self._act(step).refusal
        if refusal:
            raise rospy.ServiceException(refusal)
        return EmptyResponse()

    def _set_speed(self, request: SetSpeed) -> SetSpeedResponse:
        self._request(lambda now: self._hand.set_speed(request.motor, now))
        deadline = time.monotonic() + SPEED_TIMEOUT_S
        while self._hand.state(time.monotonic()) is State.CHANGING_SPEED:
            if time.monotonic() > deadline:
                raise rospy.ServiceException(f"The speed was not set within {SPEED_TIMEOUT_S:g} s.")
            time.sleep(RECEIVE_TIMEOUT_S)
        state = self._hand.state(time.monotonic())
        if state not in (State.READY, State.CALIBRATING):
            raise rospy.ServiceException(f"The speed was not set: the hand is {state.value}.")
        return SetSpeedResponse()

    def _set_threshold(self, request: SetTactileThreshold) -> SetTactileThresholdResponse:
        self._request(lambda now: self._hand.set_thresholds([finger.sensor for finger in request.finger]))
        return SetTactileThresholdResponse()

    def _status(self) -> tuple[int, str, dict[str, object]]:
        with self._lock:
            level, message, values = status(self._hand, self._settings, self._wire_fault, time.monotonic())
        levels = {"ok": DiagnosticStatus.OK, "warning": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}
        return levels[level], message, values


def main() -> None:
    """Reads the private parameters and drives the hand until ROS shuts down."""
    Driver(wait_for_config(Settings, rospy.get_name())).run()

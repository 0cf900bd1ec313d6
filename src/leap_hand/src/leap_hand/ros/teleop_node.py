"""The node leap_hand_node: Human messages in, commands of the ReFlex hand out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Bool
from std_srvs.srv import Empty

from common import clock
from common.config import parse
from common.errors import DeviceError, RigError
from common.frames import BASE
from common.robot_hand import HAND
from common.ros.calibration_use import check_use
from common.ros.diagnostics import Diagnostics, StageTimes
from common.ros.node import run, while_running
from common.ros.params import arm_frames, private_config, wait_for_config
from common.ros.policy_input import PolicyInput
from common.ros.publishing import DirectPublisher
from common.ros.service_calls import call
from common.simulated import said_by
from common.teleop_record import LED, teleop_record
from leap_hand.config import HandConfig, NodeConfig
from leap_hand.force_limit import FEELING, FingerFeedback, ForceLimit, LimitedCommand
from leap_hand.numbers import ANSWER_TIMEOUT_S, FIRST_STATE_S, SETTLING_S
from leap_hand.ros.operators import FILES, OPERATOR, operator_file, with_operator
from leap_hand.teleop import GripperResult, GripperState, HandTeleop
from leap_motion.frames import TrackingFrame
from leap_motion.ros.tracking import ReceivedHuman, Subscribe, subscribe
from reflex.transport import LOOPBACK
from reflex_msgs.msg import Hand, RadianServoCommands
from rig_msgs.msg import PolicyActions, TeleopState
from rig_msgs.srv import ChooseOperator, ChooseOperatorRequest

OPERATOR_PARAM = "leap_hand_node/operator"


class HandTeleopNode:
    """Runs the chain on each frame, limits the fingers' force, and watches for the stream falling silent. `of`:
    namespace of the arm with a slash, in a node for several."""

    def __init__(self, teleop: HandTeleop, force_limit: ForceLimit, of: str = "") -> None:
        self._teleop = teleop
        self._force_limit = force_limit
        self._of = of
        self._wanted: np.ndarray | None = None
        self._limited = LimitedCommand(teleop.open_pose, {}, "")
        self._lock = clock.Lock()
        self._result = GripperResult(GripperState.WAITING, "no tracking frames came yet", None)
        self._commands_sent = 0
        commands, _ = HAND.commands
        self._commands = DirectPublisher(of + commands, RadianServoCommands, queue_size=1)
        self._stage_times = StageTimes("leap_hand", of)
        Diagnostics("leap_hand", self._diagnostics, of)
        self._state_received = clock.Event()
        rospy.Service(f"{of}leap_hand/choose_operator", ChooseOperator, self._on_operator)
        rospy.Subscriber(of + HAND.state, Hand, self._on_hand_state, queue_size=1, tcp_nodelay=True)
        self._policy = PolicyInput(PolicyActions, arm_frames(of)(BASE), len(HAND.motors), of)

    def run(self, subscribe: Subscribe) -> None:
        """Follows the operator's hand once the state of the robot hand is known, until ROS shuts down."""
        self._state_received.wait(FIRST_STATE_S)
        rospy.Subscriber(f"{self._of}kuka/gripper_control", Bool, self._on_gripper, queue_size=1, tcp_nodelay=True)
        arm = f"{self._of}leap_kuka/state"
        rospy.Subscriber(arm, TeleopState, self._on_arm_teleop, queue_size=10, tcp_nodelay=True)
        subscribe(self._on_frame, ReceivedHuman)
        while not rospy.is_shutdown():
            with self._lock:
                self._carry_out(self._teleop.silence(clock.monotonic()))
            clock.sleep(0.1)

    def _on_operator(self, request: ChooseOperatorRequest) -> tuple[bool, str]:
        """Reads the mapping beside the frames, and takes it between two of them."""
        name, of = request.operator, self._of
        try:
            values = with_operator(name, rospy.get_param(f"{of}leap_hand"))
            config = parse(HandConfig, values, "leap_hand/", others=(FILES,))
            _check_origin(config, name, of, values[FILES])
        except RigError as error:
            return False, f"The mapping of the fingers stays. {error}"
        with self._lock:
            if not self._teleop.remap(config):
                return False, "The mapping of the fingers stays: switch the control of the gripper off first."
        rospy.delete_param(f"{of}leap_hand")
        rospy.set_param(f"{of}leap_hand", values)
        rospy.set_param(f"{of}{OPERATOR_PARAM}", name)
        sentence = f"The finger mapping is that of {name}." if name else "The finger mapping is nobody's own."
        rospy.loginfo(sentence)
        return True, sentence

    def _on_gripper(self, message: Bool) -> None:
        with while_running(), self._lock:
            self._carry_out(self._teleop.switch(message.data))

    def _on_arm_teleop(self, message: TeleopState) -> None:
        state = teleop_record(message)
        with self._lock:
            self._teleop.steered_by(state.owner, clock.monotonic(), state.keep_grip, state.hold == LED)

    def _on_frame(self, frame: TrackingFrame, stamp: rospy.Time) -> None:
        with self._lock:
            result = self._teleop.step(frame, clock.monotonic())
            action = self._policy.now
            if result is not None and action is not None and action.fingers.size:
                result = self._teleop.lead(action.fingers, clock.monotonic()) or result
            self._carry_out(result)
            if result is not None and result.command is not None:
                self._stage_times.done(stamp)

    def _on_hand_state(self, hand: Hand) -> None:
        with while_running(), self._lock:
            stopped = self._force_limit.update(finger_feedback(hand), clock.monotonic())
            if stopped and self._wanted is not None:
                self._send(self._wanted)
            self._state_received.set()

    def _carry_out(self, result: GripperResult | None) -> None:
        if result is None:
            return
        if result.command is not None:
            self._send(result.command)
        if (result.state, result.reason) != (self._result.state, self._result.reason):
            lost = result.state is GripperState.KEEPING
            log = rospy.logwarn if lost else rospy.loginfo
            log("%sHand %s: %s.", f"{self._of[:-1]}: " if self._of else "", result.state.value, result.reason)
        self._result = result

    def _send(self, wanted: np.ndarray) -> None:
        before, allowed = self._limited, self._force_limit.clip(wanted, clock.monotonic())
        self._commands.publish(RadianServoCommands(allowed.command.tolist()))
        self._commands_sent += 1
        self._wanted, self._limited = wanted, allowed
        for finger in allowed.limited.keys() - before.limited.keys():
            rospy.loginfo("The %s is not closed further (%s).", finger, allowed.limited[finger])
        for finger in before.limited.keys() - allowed.limited.keys():
            rospy.loginfo("The %s may close again.", finger)
        if allowed.silence and allowed.silence != before.silence:
            rospy.logwarn("Force limit: %s.", allowed.silence)

    def _diagnostics(self):
        limited, silence = self._limited.limited, self._limited.silence
        values = {
            "state": self._result.state.value,
            "commands_sent": self._commands_sent,
            **dataclasses.asdict(self._teleop.counts),
            "limited": ", ".join(f"{finger} ({why})" for finger, why in limited.items()),
            "limit_trips": self._force_limit.trips,
        }
        if silence:
            return DiagnosticStatus.WARN, f"{self._result.reason}; {silence}", values
        level = DiagnosticStatus.OK if self._result.state is GripperState.FOLLOWING else DiagnosticStatus.WARN
        return level, self._result.reason, values


def finger_feedback(hand: Hand) -> FingerFeedback:
    motors = hand.motor[: len(FEELING)]
    return FingerFeedback(
        angles=tuple(motor.joint_angle for motor in motors),
        pressures=tuple(tuple(finger.pressure) for finger in hand.finger),
        loads=tuple(motor.load for motor in motors),
    )


def calibrate(timeout: float, of: str = "") -> None:
    """Has the robot hand calibrate itself, once its services are there within `timeout` [s], and waits for the end.
    `of`: namespace of the arm with a slash, in a node for several. Raises DeviceError: a service is not there,
    refuses, or does not answer; rospy.ROSInterruptException: ROS shut down."""
    services = [of + name for name in HAND.calibrations]
    for name in services:
        rospy.loginfo("Waiting for the service %s.", name)
        try:
            rospy.wait_for_service(name, timeout)
        except rospy.ROSInterruptException:
            raise
        except rospy.ROSException:
            absent = f"The service {name} is not there after {timeout:g} s"
            raise DeviceError(f"{absent}: is the driver of the ReFlex hand running?") from None
    for name in services:
        call(name, Empty, timeout=ANSWER_TIMEOUT_S)
    rospy.loginfo("The hand calibrates; commands follow in %g s.", SETTLING_S)
    end = clock.monotonic() + SETTLING_S
    while clock.monotonic() < end:
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shut down during the calibration")
        clock.sleep(0.05)


def _check_origin(config: HandConfig, operator: str, of: str, files: Mapping[str, Mapping[str, Any]]) -> None:
    """Raises ConfigError if one of the files was measured with simulated devices and the robot hand is real; warns
    of an operator's file that does not say."""
    measured = f"The finger mapping {operator_file(operator or 'NAME')} of operator:="
    simulated_hand = rospy.get_param(f"{of}reflex_takktile_driver/network_interface", None) == LOOPBACK
    again = "Run rosrun leap_hand hand_wizard.py with a real tracker."
    for name, values in files.items():
        said = said_by(values, f"{of}leap_hand/{FILES}/{name}/")
        if name == OPERATOR:
            check_use(measured, said, simulated_hand, again)
        else:
            check_use(f"The hand's file of {name}:=", bool(said), simulated_hand, again)
    what = measured if operator else f"The finger mapping under {of}leap_hand/"
    check_use(what, bool(config.simulated), simulated_hand, again)


def start(node: NodeConfig, subscribe: Subscribe = subscribe, of: str = "") -> None:
    """Follows the tracking frames of `subscribe` until ROS shuts down; `of` as of HandTeleopNode."""
    config = wait_for_config(HandConfig, f"{of}leap_hand", others=(FILES,))
    if node.operator:
        rospy.loginfo("The finger mapping is that of %s.", node.operator)
    _check_origin(config, node.operator, of, rospy.get_param(f"{of}leap_hand/{FILES}", {}))
    calibrate(node.service_timeout, of)
    HandTeleopNode(HandTeleop(config, node.hand_only, node.hand), ForceLimit(config), of).run(subscribe)


def main() -> None:
    run("leap_hand_node", lambda: start(private_config(NodeConfig)))

"""The node leap_hand_node: Human messages in, commands of the ReFlex hand out."""

from __future__ import annotations

import threading
import time

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Bool

from common.ros.diagnostics import Diagnostics
from common.ros.node import run, while_running
from common.ros.params import private_config, wait_for_config
from common.ros.stage_times import StageTimes
from leap_hand.config import HandConfig, NodeConfig
from leap_hand.force_limit import ForceLimit, LimitedCommand
from leap_hand.ros.calibration import calibrate
from leap_hand.ros.hand_state import state_from_hand
from leap_hand.ros.tracking import frame_from_human
from leap_hand.teleop import FOLLOWING, WAITING, HandResult, Teleop
from leap_motion.msg import Human
from reflex_msgs.msg import Hand, RadianServoCommands

WATCH_PERIOD_S = 0.1
HUMAN_BUFFER_BYTES = 2**20
"""Room for many messages: rospy drops all but the newest only among those that it has read."""
FIRST_STATE_S = 2.0
"""The hand's state comes so soon after the node has subscribed to it."""


class TeleopNode:
    """Runs the chain on each message, stops fingers that press, and watches for the stream falling silent."""

    def __init__(self, teleop: Teleop, force_limit: ForceLimit) -> None:
        self._teleop = teleop
        self._force_limit = force_limit
        self._wanted: np.ndarray | None = None
        self._limited = LimitedCommand(teleop.open_pose, {}, "")
        self._lock = threading.Lock()
        self._result = HandResult(WAITING, "no tracking frames came yet", None)
        self._commands_sent = 0
        self._commands = rospy.Publisher(
            "reflex_takktile/radian_hand_command", RadianServoCommands, queue_size=1, tcp_nodelay=True
        )
        self._stage_times = StageTimes("leap_hand")
        Diagnostics("leap_hand", self._diagnostics)
        self._felt = threading.Event()
        rospy.Subscriber("reflex_takktile/hand_state", Hand, self._on_hand_state, queue_size=1, tcp_nodelay=True)

    def run(self) -> None:
        """Follows the person's hand as soon as the robot hand is felt, and watches the stream until ROS shuts down."""
        self._felt.wait(FIRST_STATE_S)
        rospy.Subscriber("kuka/gripper_control", Bool, self._on_gripper, queue_size=1)
        rospy.Subscriber(
            "leap_motion/leap_device",
            Human,
            self._on_human,
            queue_size=1,
            buff_size=HUMAN_BUFFER_BYTES,
            tcp_nodelay=True,
        )
        while not rospy.is_shutdown():
            with self._lock:
                self._carry_out(self._teleop.silence(time.monotonic()))
            time.sleep(WATCH_PERIOD_S)

    def _on_gripper(self, message: Bool) -> None:
        with self._lock:
            self._carry_out(self._teleop.switch(message.data))

    def _on_human(self, human: Human) -> None:
        with while_running(), self._lock:
            result = self._teleop.step(frame_from_human(human, rospy.Time.now()), time.monotonic())
            self._carry_out(result)
            if result is not None and result.command is not None:
                self._stage_times.done(human.header.stamp)

    def _on_hand_state(self, hand: Hand) -> None:
        with while_running(), self._lock:
            if self._force_limit.feel(state_from_hand(hand), time.monotonic()) and self._wanted is not None:
                self._send(self._wanted)
            self._felt.set()

    def _carry_out(self, result: HandResult | None) -> None:
        """Sends the command of a result, and says what changed."""
        if result is None:
            return
        if result.command is not None:
            self._send(result.command)
        if (result.state, result.reason) != (self._result.state, self._result.reason):
            rospy.loginfo("Hand %s: %s.", result.state, result.reason)
        self._result = result

    def _send(self, wanted: np.ndarray) -> None:
        """Sends as much of a command as the force limit allows, and says what that limit changed."""
        before, allowed = self._limited, self._force_limit.clip(wanted, time.monotonic())
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
            "state": self._result.state,
            "commands_sent": self._commands_sent,
            "limited": ", ".join(f"{finger} ({why})" for finger, why in limited.items()),
            "limit_trips": self._force_limit.trips,
        }
        if silence:
            return DiagnosticStatus.WARN, f"{self._result.reason}; {silence}", values
        level = DiagnosticStatus.OK if self._result.state == FOLLOWING else DiagnosticStatus.WARN
        return level, self._result.reason, values


def _run() -> None:
    node = private_config(NodeConfig)
    config = wait_for_config(HandConfig, "leap_hand")
    calibrate(node.service_timeout)
    TeleopNode(Teleop(config, node.hand_only), ForceLimit(config)).run()


def main() -> None:
    """Runs the node until ROS shuts down."""
    run("leap_hand_node", _run)

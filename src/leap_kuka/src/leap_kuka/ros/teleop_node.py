"""The node leap_kuka_node: Human messages in, the frames of hand, desired tool and desired flange out on tf."""

from __future__ import annotations

import dataclasses
import threading
import time

import rospy
from tf2_msgs.msg import TFMessage

from common.config import required
from common.frames import BASE, FLANGE_DESIRED, HAND, TOOL_DESIRED, VIRTUAL_LEAP
from common.ros.conversions import stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.node import run, while_running
from common.ros.params import wait_for_config, wait_for_param
from common.ros.stage_times import StageTimes
from leap_kuka.config import ArmConfig, LeapConfig
from leap_kuka.ros.hold_service import HoldService
from leap_kuka.ros.stream_status import StreamStatus
from leap_kuka.ros.tracking import frame_from_human
from leap_kuka.teleop import Teleop, TeleopResult
from leap_motion.msg import Human

WATCH_PERIOD_S = 0.1
HUMAN_BUFFER_BYTES = 2**20
"""Room for many messages: rospy drops all but the newest only among those that it has read."""


class TeleopNode:
    """Runs the chain on each message, and watches for the stream falling silent."""

    def __init__(self, teleop: Teleop) -> None:
        self._teleop = teleop
        self._lock = threading.Lock()
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=10, tcp_nodelay=True)
        self._stage_times = StageTimes("leap_kuka")
        self._status = StreamStatus(teleop.box, VIRTUAL_LEAP)
        self._hold_service = HoldService(teleop, self._lock)
        Diagnostics("leap_kuka", self._diagnostics)
        rospy.Subscriber(
            "leap_motion/leap_device",
            Human,
            self._on_human,
            queue_size=1,
            buff_size=HUMAN_BUFFER_BYTES,
            tcp_nodelay=True,
        )

    def watch(self) -> None:
        """Watches the stream until ROS shuts down."""
        while not rospy.is_shutdown():
            with self._lock:
                silent = self._teleop.silence(time.monotonic())
                if silent is not None:
                    self._status.update(silent)
            self._status.flush()
            time.sleep(WATCH_PERIOD_S)

    def _on_human(self, human: Human) -> None:
        with while_running(), self._lock:
            result = self._teleop.step(frame_from_human(human, rospy.Time.now()), time.monotonic())
            if result.usable:
                self._tf.publish(self._transforms(result, human.header.stamp))
                self._stage_times.done(human.header.stamp)
            self._status.update(result)

    def _transforms(self, result: TeleopResult, stamp: rospy.Time) -> TFMessage:
        """Returns all frames of one tracking frame, so that a listener has either all of them or none."""
        transforms = [stamped_transform(result.T_base_virtual, BASE, VIRTUAL_LEAP, stamp)]
        if result.T_virtual_hand is not None:
            transforms.append(stamped_transform(result.T_virtual_hand, VIRTUAL_LEAP, HAND, stamp))
        if result.T_virtual_tool is not None:
            transforms.append(stamped_transform(result.T_virtual_tool, VIRTUAL_LEAP, TOOL_DESIRED, stamp))
            transforms.append(stamped_transform(self._teleop.T_tool_flange, TOOL_DESIRED, FLANGE_DESIRED, stamp))
        return TFMessage(transforms)

    def _diagnostics(self):
        level, reason, state = self._status.text
        return level, reason, {"state": state, **dataclasses.asdict(self._teleop.counts)}


def read_arm_config() -> ArmConfig:
    """Returns the arm's parameters once all of them are there; the controller uploads kuka/ws_center last."""
    for key in required(ArmConfig):
        wait_for_param(f"kuka/{key}")
    return wait_for_config(ArmConfig, "kuka", others=rospy.get_param("kuka"))


def _run() -> None:
    leap = wait_for_config(LeapConfig, "leap")
    TeleopNode(Teleop(leap, read_arm_config())).watch()


def main() -> None:
    """Runs the node until ROS shuts down."""
    run("leap_kuka_node", _run)

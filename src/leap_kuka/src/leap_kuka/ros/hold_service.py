"""The service leap_kuka/hold_tool."""

from __future__ import annotations

import threading
import time

import rospy

from common.frames import BASE
from common.ros.conversions import pose_in
from leap_kuka.teleop import ArmTeleop
from rig_msgs.msg import KukaStatus
from rig_msgs.srv import HoldTool, HoldToolRequest


class HoldService:
    """Passes requests and the state of the arm's control to the chain, which `lock` protects."""

    def __init__(self, teleop: ArmTeleop, lock: threading.Lock) -> None:
        self._teleop = teleop
        self._lock = lock
        rospy.Subscriber("kuka/status", KukaStatus, self._on_status, queue_size=1)
        rospy.Service("leap_kuka/hold_tool", HoldTool, self._answer)

    def _on_status(self, status: KukaStatus) -> None:
        with self._lock:
            self._teleop.control(status.control_on)

    def _answer(self, request: HoldToolRequest) -> tuple[bool, str]:
        success, sentence = self._hold(request)
        (rospy.loginfo if success else rospy.logwarn)(sentence)
        return success, sentence

    def _hold(self, request: HoldToolRequest) -> tuple[bool, str]:
        with self._lock:
            if request.duration == 0.0:
                answer = self._teleop.end_hold()
            else:
                try:
                    T_base_tool = pose_in(BASE, request.tool)
                except ValueError as error:
                    return False, f"The tool is not held: {error}."
                answer = self._teleop.hold(T_base_tool, request.duration, time.monotonic())
        return answer.success, answer.sentence

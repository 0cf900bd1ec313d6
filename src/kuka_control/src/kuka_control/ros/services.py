"""The five services of a controller."""

from __future__ import annotations

import os
import threading

import rospy

from kuka_control.loop.switches import Switches, SwitchReply
from kuka_msgs.srv import (
    exitApp,
    exitAppEmergency,
    setGripperControl,
    setKukaControl,
    setScalingFactor,
)

EMERGENCY_EXIT_CODE = 2
ANSWER_S = 0.05
"""How long the process lives on after an emergency call, so that the answer gets out [s]."""


class Services:
    """Offers the services under kuka/ and turns requests into positions of the switches."""

    def __init__(self, switches: Switches) -> None:
        self._lock = threading.Lock()
        self._switches = switches
        rospy.Service("kuka/exit_app_emergency", exitAppEmergency, self._end_at_once)
        rospy.Service("kuka/exit_app", exitApp, lambda _: self._ask(switches.request_exit))
        rospy.Service("kuka/kuka_control", setKukaControl, lambda r: self._ask(switches.set_control, r.data))
        rospy.Service("kuka/gripper_control", setGripperControl, lambda r: self._ask(switches.set_gripper, r.data))
        rospy.Service("kuka/scaling_factor", setScalingFactor, lambda r: self._ask(switches.set_scale, r.data))

    def hold(self, why: str) -> None:
        """Switches control off, and keeps it off until `release`; `why` is part of a sentence."""
        with self._lock:
            self._switches.hold(why)

    def release(self) -> None:
        """Lets control be switched on again."""
        with self._lock:
            self._switches.release()

    def _ask(self, change, *values):
        with self._lock:
            answer: SwitchReply = change(*values)
        (rospy.loginfo if answer.success else rospy.logwarn)(answer.message)
        return answer.success, answer.message

    def _end_at_once(self, request):
        """Needs neither the control loop nor the robot, so it also works when those hang."""
        timer = threading.Timer(ANSWER_S, os._exit, [EMERGENCY_EXIT_CODE])
        timer.daemon = True
        timer.start()
        return True, "The controller exits at once; the robot holds its last goal or completes its PTP motion."

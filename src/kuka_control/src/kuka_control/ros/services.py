"""The services of a controller: those for its switches, and the check of a tool pose."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import rospy

from common import clock
from common.frames import BASE, ONE_ARM, ArmFrames
from common.modes import Mode
from common.ros.conversions import message_from_pose, pose_in
from kuka_control.model.rig import Rig
from kuka_control.model.switches import Switches, SwitchReply
from kuka_control.model.target import MotionScaling, check_tool_pose, refused, seed
from kuka_msgs.srv import exitApp, exitAppEmergency, setGripperControl, setKukaControl, setPayload, setScalingFactor
from rig_msgs.srv import CheckToolPose, CheckToolPoseRequest, CheckToolPoseResponse

ANSWER_S = 0.05  # how long the process lives on after an emergency call, so that the answer gets out [s]


EXITS = "Nothing was changed: the controller exits at once."  # what waited while it hung comes after the stop, too


class Services:
    """Offers the services under kuka/ and turns requests into positions of the switches."""

    def __init__(
        self,
        switches: Switches,
        stop: Callable[[], str | None] = lambda: None,
        pausable: bool = False,
        softens: bool = False,
        guide: Callable[[bool], SwitchReply] | None = None,
    ) -> None:
        """`stop` stops the arm where the robot can do that, and returns what to say of it, a part of a sentence;
        `pausable`: PTP motions can be paused; `softens`: servo modes can be soft;
        `guide`: lets a hand guide the arm; it waits for the control loop, which must not wait for it."""
        self._stop = stop
        self._lock = clock.Lock()
        self._switches, self._exits = switches, False
        rospy.Service("kuka/exit_app_emergency", exitAppEmergency, self._end_at_once)
        rospy.Service("kuka/exit_app", exitApp, lambda _: self._ask(switches.request_exit))
        rospy.Service("kuka/kuka_control", setKukaControl, lambda r: self._ask(switches.set_control, r.data))
        if pausable:
            rospy.Service("kuka/pause", setKukaControl, lambda r: self._ask(switches.set_paused, r.data))
        if softens:
            rospy.Service("kuka/soft", setKukaControl, lambda r: self._ask(switches.set_soft, r.data))
        if guide is not None:
            rospy.Service("kuka/guide", setKukaControl, lambda r: self._answer(guide, r.data))
        rospy.Service("kuka/gripper_control", setGripperControl, lambda r: self._ask(switches.set_gripper, r.data))
        rospy.Service("kuka/set_payload", setPayload, lambda r: self._ask(switches.set_payload, r.data))
        rospy.Service("kuka/scaling_factor", setScalingFactor, lambda r: self._ask(switches.set_scale, r.data))

    def disengage(self) -> None:
        """Switches control off: the operator could not do it any more."""
        self._ask(self._switches.set_control, False)

    def stop_motion(self, why: str) -> None:
        """Stops a motion that runs, where the robot can do that; `why` is part of a sentence."""
        with self._lock:
            self._switches.stop_motion(why)

    def hold(self, why: str) -> None:
        """Switches control off, and keeps it off until `release`; `why` is part of a sentence."""
        with self._lock:
            self._switches.hold(why)

    def release(self) -> None:
        with self._lock:
            self._switches.release()

    def _ask(self, change, *values):
        with self._lock:
            return self._answer(change, *values)

    def _answer(self, change, *values):
        answer: SwitchReply = SwitchReply(False, EXITS) if self._exits else change(*values)
        (rospy.loginfo if answer.success else rospy.logwarn)(answer.message)
        return answer.success, answer.message

    def _end_at_once(self, request):
        """Needs neither the control loop nor the robot, so it also works when those hang."""
        emergency_exit_code = 2
        self._exits = True
        timer = clock.Timer(ANSWER_S, os._exit, [emergency_exit_code])
        timer.daemon = True
        timer.start()  # first: a link that hangs must not delay the end, with which the robot loses its client
        left_behind = self._stop() or "the robot holds its last goal or completes its PTP motion"
        return True, f"The controller exits at once; {left_behind}."


def offer_tool_check(
    rig: Rig,
    read: Callable[[], tuple[Mode, np.ndarray | None, MotionScaling]],
    collision: Callable[[np.ndarray], str | None],
    frames: ArmFrames = ONE_ARM,
) -> None:
    """Answers kuka/check_tool_pose from the threads of its callers; it takes no lock of the control loop. `read`
    returns the controller's mode, the measured joints, shape (7,) [rad] or None, and the scaling; `collision` as for
    `check_tool_pose`."""

    def answer(request: CheckToolPoseRequest) -> CheckToolPoseResponse:
        try:
            T_base_tool = pose_in(frames(BASE), request.tool)
        except ValueError as error:
            check = refused(f"{error}.")
            return CheckToolPoseResponse(success=False, message=check.sentence, obstacle=check.obstacle)
        mode, joints, scaling = read()
        if mode is Mode.MOVING:
            check = refused("a program moves the arm.")
            return CheckToolPoseResponse(success=False, message=check.sentence, obstacle=check.obstacle)
        q_seed = seed(mode, joints, rig.home.q)
        check = check_tool_pose(rig.chain, T_base_tool, scaling, q_seed, mode is Mode.SERVO, collision)
        response = CheckToolPoseResponse(success=check.T_base_desired is not None, message=check.sentence)
        response.obstacle = check.obstacle or ""
        if check.T_base_desired is not None:
            response.desired = message_from_pose(check.T_base_desired)
        return response

    rospy.Service("kuka/check_tool_pose", CheckToolPose, answer)

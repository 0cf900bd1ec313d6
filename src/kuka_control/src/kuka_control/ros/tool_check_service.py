"""The service kuka/check_tool_pose. It asks copies of what the control loop knows and takes no lock of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rospy

from common.frames import BASE
from common.ros.conversions import message_from_pose, pose_in
from kuka_control.model.rig import Rig
from kuka_control.model.tool_check import ToolCheck, check_tool_pose, seed
from rig_msgs.srv import CheckToolPose, CheckToolPoseRequest, CheckToolPoseResponse


class ToolCheckService:
    """Answers from the threads of its callers.

    Args:
        rig: the arm.
        read: returns the controller's mode, the measured joints, shape (7,) [rad] or None, and the scaling factor.
    """

    def __init__(self, rig: Rig, read: Callable[[], tuple[str, np.ndarray | None, float]]) -> None:
        self._rig = rig
        self._read = read
        rospy.Service("kuka/check_tool_pose", CheckToolPose, self._answer)

    def _answer(self, request: CheckToolPoseRequest) -> CheckToolPoseResponse:
        check = self._check(request.tool)
        response = CheckToolPoseResponse(success=check.T_base_desired is not None, message=check.sentence)
        if check.T_base_desired is not None:
            response.desired = message_from_pose(check.T_base_desired)
        return response

    def _check(self, tool) -> ToolCheck:
        try:
            T_base_tool = pose_in(BASE, tool)
        except ValueError as error:
            return ToolCheck(f"The tool pose is refused: {error}.")
        mode, joints, scale = self._read()
        return check_tool_pose(self._rig.chain, T_base_tool, scale, seed(mode, joints, self._rig.home.q))

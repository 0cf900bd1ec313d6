"""Asks the controller whether the arm can come to a desired tool frame, without waiting for its answer."""

from __future__ import annotations

import numpy as np
import rospy

from common import clock
from common.frames import BASE, ONE_ARM, ArmFrames
from common.poses import pose
from common.ros.conversions import stamped_pose
from common.ros.service_calls import ServiceAbsent, ServiceClient, ServiceFailed
from common.rotations import rotation_angle
from leap_kuka.numbers import (
    REACH_FRESH_S,
    REACH_NEAR_M,
    REACH_NEAR_RAD,
    REACH_RUNNING_S,
    REACH_START_S,
    REACH_TIMEOUT_S,
)
from leap_kuka.scaling import Scaling
from rig_msgs.srv import CheckToolPose

ASKING = "the controller has not answered yet whether the arm can come"
SILENT = "the controller does not answer whether the arm can come"


class ReachCheck:
    """The controller's newest answer. Only where nobody offers the service, every pose counts as reachable.
    `scaling` is the controller's; `of`: its namespace with a slash, if it is not this node's own."""

    def __init__(self, scaling: Scaling, frames: ArmFrames = ONE_ARM, of: str = "") -> None:
        self._base = frames(BASE)
        self.scaling = scaling
        self._client = ServiceClient(f"{of}kuka/check_tool_pose", CheckToolPose)
        self._question = np.eye(4)
        self._answer: tuple[str | None, np.ndarray, float] = ASKING, self._question, -REACH_FRESH_S
        self._asked, self._period = clock.Event(), REACH_START_S
        clock.Thread(target=self._run, name="reach check", daemon=True).start()

    def __call__(self, T_base_desired: np.ndarray, starts: bool) -> str | None:
        """Asks about a pose, shape (4, 4) [m]; returns the newest answer: why the arm cannot come, or None. Where a
        stream `starts`, only the answer for a pose near this one counts."""
        p = self.scaling.scaled(T_base_desired[:3, 3])
        self._question = pose(T_base_desired[:3, :3], p)
        self._period = REACH_START_S if starts else REACH_RUNNING_S
        self._asked.set()
        answer, T, at = self._answer
        near = (
            np.linalg.norm(T[:3, 3] - p) <= REACH_NEAR_M
            and rotation_angle(T[:3, :3].T @ T_base_desired[:3, :3]) <= REACH_NEAR_RAD
        )
        return answer if clock.monotonic() - at < REACH_FRESH_S and (near or not starts or answer == SILENT) else ASKING

    def _run(self) -> None:
        while not rospy.is_shutdown():
            if not self._asked.wait(REACH_START_S):
                continue
            self._asked.clear()
            question = self._question
            self._answer = self._ask(question), question, clock.monotonic()
            clock.sleep(self._period)

    def _ask(self, T_base_tool: np.ndarray) -> str | None:
        try:
            tool = stamped_pose(T_base_tool, self._base, rospy.Time.now())
            return self._client(tool, timeout=REACH_TIMEOUT_S).obstacle or None
        except ServiceAbsent:
            return None
        except ServiceFailed:
            return SILENT
        except Exception as error:  # this thread must not die: without it no stream would ever start again
            rospy.logerr_once("The check whether the arm can come has failed: %r.", error)
            return f"the check whether the arm can come has failed: {error!r}"

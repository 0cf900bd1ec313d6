"""Asks the controller whether the arm can come to a desired tool frame, without waiting for its answer."""

from __future__ import annotations

from typing import NamedTuple

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


class ReachAnswer(NamedTuple):
    obstacle: str | None  # why the arm cannot come, the end of a sentence; None if it can
    T_base_tool: np.ndarray  # the pose of the question, shape (4, 4) [m]
    at: float  # when it came [s]
    of_any_pose: bool = False  # whether every other pose has this answer, too


class ReachCheck:
    """The controller's newest answer. Only where nobody offers the service, every pose counts as reachable.
    `scaling` is the controller's; `of`: its namespace with a slash, if it is not this node's own."""

    def __init__(self, scaling: Scaling, frames: ArmFrames = ONE_ARM, of: str = "") -> None:
        self._base = frames(BASE)
        self.scaling = scaling
        self._client = ServiceClient(f"{of}kuka/check_tool_pose", CheckToolPose)
        self._question = np.eye(4)
        self._answer = ReachAnswer(ASKING, self._question, -REACH_FRESH_S)
        self._asked = clock.Event()
        self._period = REACH_START_S
        clock.Thread(target=self._run, name="reach check", daemon=True).start()

    def __call__(self, T_base_desired: np.ndarray, starts: bool) -> str | None:
        """Asks about a pose, shape (4, 4) [m]; returns the newest answer: why the arm cannot come, or None. Where a
        stream `starts`, only the answer for a pose near this one counts."""
        p = self.scaling.scaled(T_base_desired[:3, 3])
        self._question = pose(T_base_desired[:3, :3], p)
        self._period = REACH_START_S if starts else REACH_RUNNING_S
        self._asked.set()
        answer = self._answer
        T = answer.T_base_tool
        near = (
            np.linalg.norm(T[:3, 3] - p) <= REACH_NEAR_M
            and rotation_angle(T[:3, :3].T @ T_base_desired[:3, :3]) <= REACH_NEAR_RAD
        )
        fresh = clock.monotonic() - answer.at < REACH_FRESH_S
        return answer.obstacle if fresh and (near or not starts or answer.of_any_pose) else ASKING

    def _run(self) -> None:
        while not rospy.is_shutdown():
            if not self._asked.wait(REACH_START_S):
                continue
            self._asked.clear()
            self._answer = self._ask(self._question)
            clock.sleep(self._period)

    def _ask(self, T_base_tool: np.ndarray) -> ReachAnswer:
        obstacle, of_any_pose = None, False
        try:
            tool = stamped_pose(T_base_tool, self._base, rospy.Time.now())
            obstacle = self._client(tool, timeout=REACH_TIMEOUT_S).obstacle or None
        except ServiceAbsent:
            pass
        except ServiceFailed:
            obstacle, of_any_pose = SILENT, True
        except Exception as error:  # this thread must not die: without it no stream would ever start again
            rospy.logerr_once("The check whether the arm can come has failed: %r.", error)
            obstacle = f"the check whether the arm can come has failed: {error!r}"
        return ReachAnswer(obstacle, T_base_tool, clock.monotonic(), of_any_pose)

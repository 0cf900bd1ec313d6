"""Asks the controller whether the arm can come to a desired tool frame, without waiting for its answer."""

from __future__ import annotations

import threading
import time

import numpy as np
import rospy

from common.frames import BASE
from common.poses import pose
from common.ros.conversions import stamped_pose
from common.ros.service_calls import ServiceClient, ServiceFailed
from rig_msgs.srv import CheckToolPose

TIMEOUT_S = 0.5
PERIOD_S = 0.1  # shortest time between two questions
FRESH_S = 0.5  # an older answer is none
ASKING = "the controller has not answered yet whether the arm can come"


class ReachCheck:
    """The controller's newest answer; without a controller, every pose counts as reachable.

    `ws_center` is the point from which the scaling factor `scale` counts, shape (3,) [m].
    """

    def __init__(self, ws_center: np.ndarray) -> None:
        self._ws_center, self.scale = ws_center, 1.0
        self._client = ServiceClient("kuka/check_tool_pose", CheckToolPose)
        self._question = np.eye(4)
        self._answer: tuple[str | None, float] = ASKING, -FRESH_S
        self._asked = threading.Event()
        threading.Thread(target=self._run, name="reach check", daemon=True).start()

    def __call__(self, T_base_desired: np.ndarray) -> str | None:
        """Asks about a pose, shape (4, 4) [m]; returns the newest answer: why the arm cannot come, or None."""
        p = self._ws_center + self.scale * (T_base_desired[:3, 3] - self._ws_center)
        self._question = pose(T_base_desired[:3, :3], p)
        self._asked.set()
        answer, at = self._answer
        return answer if time.monotonic() - at < FRESH_S else ASKING

    def _run(self) -> None:
        while not rospy.is_shutdown():
            if not self._asked.wait(PERIOD_S):
                continue
            self._asked.clear()
            try:
                tool = stamped_pose(self._question, BASE, rospy.Time.now())
                obstacle = self._client(tool, timeout=TIMEOUT_S).obstacle or None
            except ServiceFailed:
                obstacle = None
            self._answer = obstacle, time.monotonic()
            time.sleep(PERIOD_S)

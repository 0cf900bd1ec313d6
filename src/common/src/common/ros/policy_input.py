"""The actions of a program that steers, as they come on leap_kuka/policy_actions."""

from __future__ import annotations

from typing import Any

import numpy as np
import rospy

from common import clock
from common.action_stream import ActionChunk, ActionStream, PolicyAction
from common.ros.conversions import pose_from_message

POLICY_ACTIONS = "leap_kuka/policy_actions"


class PolicyInput:
    """Takes the messages for an arm and its hand; what is refused is logged once. `message_type`: PolicyActions; `of`:
    namespace of the arm with a slash, in a node for several; `base`: its base frame; `motors`: of its hand."""

    def __init__(self, message_type: type, base: str, motors: int, of: str = "") -> None:
        self._base, self._motors = base, motors
        self._stream = ActionStream(motors)
        self._lock = clock.Lock()
        self._refused = ""
        rospy.Subscriber(of + POLICY_ACTIONS, message_type, self._on_actions, queue_size=1, tcp_nodelay=True)

    def at(self, now: rospy.Time) -> PolicyAction | None:
        """Returns the action that holds."""
        with self._lock:
            return self._stream.at(now.to_sec())

    def clear(self) -> None:
        with self._lock:
            self._stream.clear()

    def _on_actions(self, message: Any) -> None:
        now = rospy.Time.now().to_sec()
        refused = ""
        with self._lock:
            try:
                self._stream.take(self._chunk(message), now)
            except ValueError as error:
                self._stream.clear()
                refused = str(error)
        if refused and refused != self._refused:
            rospy.logwarn("The policy's actions are refused: %s.", refused)
        self._refused = refused

    def _chunk(self, message: Any) -> ActionChunk:
        """Raises ValueError if a pose is none."""
        if message.header.frame_id != self._base:
            raise ValueError(f"their frame is {message.header.frame_id!r}, not {self._base}")
        n = len(message.tool)
        if len(message.fingers) not in (0, n * self._motors):
            wanted = f"{self._motors} for each of {n} actions"
            raise ValueError(f"they have {len(message.fingers)} finger commands, and none or {wanted} are needed")
        T = [pose_from_message(one) for one in message.tool]
        fingers = np.array(message.fingers, dtype=float).reshape(n, -1) if n else np.zeros((0, 0))
        return ActionChunk(message.header.stamp.to_sec(), message.period, np.array(T).reshape(-1, 4, 4), fingers)

"""The actions of a program that steers, as they come on leap_kuka/policy_actions."""

from __future__ import annotations

from typing import Any

import numpy as np
import rospy

from common import clock
from common.action_stream import MOST_ACTIONS, ActionChunk, ActionStream, PolicyAction, check_chunk
from common.errors import DeviceError
from common.ros.conversions import pose_from_message
from common.ros.raw_tf import publisher_of
from common.ros.service_calls import ask_master, listens
from common.sentences import without_numbers

POLICY_ACTIONS = "leap_kuka/policy_actions"


def refuse_second_program() -> None:
    """Raises DeviceError if another program sends actions to the arm of this program's namespace, or MasterLost."""
    publishers = dict(ask_master("getSystemState")[0]).get(rospy.resolve_name(POLICY_ACTIONS), [])
    for other in publishers:
        if listens(ask_master("lookupNode", other)):
            raise DeviceError(f"{other} sends actions already, and two programs cannot steer: end it first.")


class PolicyInput:
    """Takes the messages of one program at a time for an arm and its hand; what is refused is logged once.
    `message_type`: PolicyActions; `of`: namespace of the arm with a slash, in a node for several; `base`: its base
    frame; `motors`: of its hand."""

    def __init__(self, message_type: type, base: str, motors: int, of: str = "") -> None:
        self._base, self._motors = base, motors
        self._stream = ActionStream()
        self._lock = clock.Lock()
        self._refused = self._program = ""
        rospy.Subscriber(of + POLICY_ACTIONS, message_type, self._on_actions, queue_size=1, tcp_nodelay=True)

    @property
    def now(self) -> PolicyAction | None:
        """The action that holds now."""
        with self._lock:
            return self._stream.at(clock.monotonic())

    def clear(self) -> None:
        with self._lock:
            self._stream.clear()

    def _on_actions(self, message: Any) -> None:
        program = publisher_of(message)
        if program != self._program and self.now is not None:
            other = f"{program} sends actions while those of {self._program} hold"
            rospy.logwarn_throttle(10.0, "The policy's actions are refused: %s.", other)
            return
        try:
            # From here on by the monotonic clock: that of ROS may be set, or stand.
            start = clock.monotonic() + (message.header.stamp - rospy.Time.now()).to_sec()
            chunk = self._chunk(message, start)
            check_chunk(chunk, self._motors, clock.monotonic())
        except ValueError as error:
            self.clear()
            refused = without_numbers(str(error))
            if refused != self._refused:
                rospy.logwarn("The policy's actions are refused: %s.", error)
            self._refused = refused
            return
        self._refused, self._program = "", program
        with self._lock:
            self._stream.take(chunk, clock.monotonic())

    def _chunk(self, message: Any, start: float) -> ActionChunk:
        """Returns the chunk of a message; raises ValueError if it is invalid."""
        if message.header.frame_id != self._base:
            raise ValueError(f"their frame is {message.header.frame_id!r}, not {self._base}")
        n = len(message.tool)
        if n > MOST_ACTIONS:
            raise ValueError(f"it has {n} actions, and 1 to {MOST_ACTIONS} are possible")
        if len(message.fingers) not in (0, n * self._motors):
            wanted = f"{self._motors} for each of {n} actions"
            raise ValueError(f"they have {len(message.fingers)} finger commands, and none or {wanted} are needed")
        T = [pose_from_message(one) for one in message.tool]
        fingers = np.array(message.fingers, dtype=float).reshape(n, -1) if n else np.zeros((0, 0))
        return ActionChunk(start, message.period, np.array(T).reshape(-1, 4, 4), fingers)

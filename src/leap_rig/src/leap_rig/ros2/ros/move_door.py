"""Goals from ROS 2 for an arm's action kuka/move."""

from __future__ import annotations

from functools import partial
from typing import Callable

import genpy
import rospy
from actionlib_msgs.msg import GoalStatus

from common import clock
from common.ros.action_client import ActionClient
from kuka_control.ros.move_program import SILENCE_S
from kuka_msgs.msg import MoveAction, MoveFeedback, MoveGoal, MoveResult
from leap_rig.ros2 import channels
from leap_rig.ros2.ros.bytes_of import bytes_of

STATES = {GoalStatus.SUCCEEDED: channels.SUCCEEDED, GoalStatus.PREEMPTED: channels.CANCELLED}


class MoveDoor:
    """Passes goals on, and what becomes of them to `send`, a function of channel, number of the goal, and bytes."""

    def __init__(self, name: str, send: Callable[[int, int, bytes], None]) -> None:
        self._name, self._send = name, send
        self._client = ActionClient(name, MoveAction)
        self._number: int | None = None  # of the goal that was passed on and has not ended
        self._heard = 0.0
        self._ended = clock.Event()

    def start(self, number: int, data: bytes) -> None:
        """Takes a goal; what ends it at once is its result."""
        look_s = 0.1
        try:
            goal = MoveGoal().deserialize(data)
        except genpy.DeserializationError as error:
            self._result(number, channels.ABORTED, f"The goal cannot be read: {error}.")
            return
        if not self._client.wait_for_server(rospy.Duration(look_s)):
            self._result(number, channels.ABORTED, f"Nobody offers {self._name}: start a controller first.")
            return
        self._number, self._heard = number, clock.monotonic()
        self._ended.clear()
        self._client.send_goal(goal, partial(self._done, number), feedback_cb=partial(self._feedback, number))

    def cancel(self, number: int) -> None:
        """Asks the controller to end a motion."""
        if number == self._number:
            self._client.cancel_goal()

    def look(self) -> None:
        """Ends a goal of which nothing is heard any more."""
        number = self._number
        if number is not None and clock.monotonic() - self._heard > SILENCE_S:
            self._client.cancel_goal()
            self._number = None
            sentence = f"{self._name} has reported nothing for {SILENCE_S:g} s; the controller may have ended."
            self._result(number, channels.ABORTED, sentence)

    def close(self) -> None:
        """Cancels a motion and waits a moment for its end."""
        longest_s = 1.0
        if self._number is not None:
            self._client.cancel_goal()
            self._ended.wait(longest_s)

    def _feedback(self, number: int, feedback: MoveFeedback) -> None:
        self._heard = clock.monotonic()
        if number == self._number:
            self._send(channels.FEEDBACK, number, bytes_of(feedback))

    def _done(self, number: int, state: int, result: MoveResult | None) -> None:
        if number != self._number:
            return
        self._number = None
        if result is None:
            self._result(number, channels.ABORTED, "The controller has lost the goal.")
        else:
            self._send(channels.RESULT, number, bytes([STATES.get(state, channels.ABORTED)]) + bytes_of(result))
        self._ended.set()

    def _result(self, number: int, state: int, sentence: str) -> None:
        self._send(channels.RESULT, number, bytes([state]) + bytes_of(MoveResult(message=sentence)))

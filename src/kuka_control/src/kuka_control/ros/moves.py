"""The action kuka/move: between programs, the checks of what they ask for, and the control loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import actionlib
import numpy as np
import rospy

from common import clock
from common.frames import BASE, ONE_ARM, ArmFrames
from common.ros.conversions import pose_in
from kuka_control.limits.line_plan import MoveRefused
from kuka_control.loop.commands import Step
from kuka_control.loop.moves import READY, MoveGoal, MovePlanner, MoveState, ProgramMotion, wrong_time
from kuka_msgs.msg import MoveAction, MoveFeedback, MoveResult
from kuka_msgs.msg import MoveGoal as MoveGoalMessage

FEEDBACK_S = 0.1  # period of the feedback [s]
START_S = 1.0  # the control loop has this long to start or refuse a motion [s]


class MoveServer:
    """Offers kuka/move: one motion at a time; another goal meanwhile is rejected. `read` returns the last step of the
    control loop, None before the first, and the measured joints, shape (7,); `move` is the motion that the control loop
    is to make, None while nothing is asked for; `stops`: the robot can stop a point-to-point motion."""

    def __init__(
        self,
        planner: MovePlanner,
        read: Callable[[], tuple[Step | None, np.ndarray]],
        frames: ArmFrames = ONE_ARM,
        stops: bool = False,
    ) -> None:
        self.move: ProgramMotion | None = None
        self._base = frames(BASE)
        self._stops = stops
        self._planner = planner
        self._read = read
        self._lock = clock.Lock()
        self._handle: actionlib.ServerGoalHandle | None = None
        self._number = 0
        self._due = self._asked = 0.0  # when the next feedback is due, and when the goal came [s]
        server = actionlib.ActionServer("kuka/move", MoveAction, self._goal, self._cancel, auto_start=False)
        server.start()

    def show(self, step: Step, joints: np.ndarray) -> None:
        """Reports what has become of the motion; called by the control loop after each cycle."""
        move, handle, progress, now = self.move, self._handle, step.move, clock.monotonic()
        if move is None or handle is None:
            return
        if progress is None or progress.number != move.number:
            if now - self._asked > START_S:
                self.abort(f"The controller did not start the motion. {step.reason}")
        elif progress.state is MoveState.RUNNING:
            if now >= self._due:
                self._due = now + FEEDBACK_S
                handle.publish_feedback(MoveFeedback(progress.fraction, progress.left, joints.tolist()))
        else:
            self._end(progress.state, progress.sentence, joints)

    def abort(self, sentence: str) -> None:
        """Ends what was asked for, because the control loop has stopped."""
        if self._handle is not None:
            self._end(MoveState.ABORTED, sentence, self._read()[1])

    def _end(self, state: MoveState, sentence: str, joints: np.ndarray) -> None:
        with self._lock:
            handle, self._handle, self.move = self._handle, None, None
        if handle is None:
            return
        result = MoveResult(state is MoveState.DONE, sentence, joints.tolist())
        ends = {MoveState.DONE: handle.set_succeeded, MoveState.CANCELLED: handle.set_canceled}
        ends.get(state, handle.set_aborted)(result, sentence)
        (rospy.loginfo if result.success else rospy.logwarn)("kuka/move: %s", sentence)

    def _goal(self, handle: actionlib.ServerGoalHandle) -> None:
        with self._lock:
            busy = self._handle is not None
            self._number += 1
        step, joints = self._read()
        try:
            if busy:
                raise MoveRefused("The motion before has not ended; cancel it or wait.")
            if step is None or step.mode not in READY:
                raise MoveRefused("The controller starts." if step is None else wrong_time(step.mode, step.reason))
            move = self._planner.plan(self._number, _goal_of(handle.get_goal(), self._base), joints)
        except Exception as error:  # also what nobody expects must end the goal: the program waits for it
            known = isinstance(error, MoveRefused)
            sentence = str(error) if known else f"The motion cannot be planned: {type(error).__name__}: {error}."
            handle.set_rejected(MoveResult(False, sentence, joints.tolist()), sentence)
            rospy.logwarn("kuka/move: %s", sentence)
            return
        handle.set_accepted()
        with self._lock:
            self._asked, self._handle, self.move = clock.monotonic(), handle, move

    def _cancel(self, handle: actionlib.ServerGoalHandle) -> None:
        with self._lock:
            move = self.move
            if handle != self._handle or move is None:
                return
            self.move = replace(move, cancelled=True)
        if move.line is None and not self._stops:
            rospy.logwarn("kuka/move: a point-to-point motion cannot be stopped; the arm continues to %s.", move.name)


def _goal_of(message: MoveGoalMessage, base: str) -> MoveGoal:
    if message.kind == MoveGoalMessage.JOINTS:
        return MoveGoal(np.array(message.joints), message.straight, message.velocity)
    if message.kind == MoveGoalMessage.NAMED:
        return MoveGoal(message.name, message.straight, message.velocity)
    if message.kind != MoveGoalMessage.POSE:
        raise MoveRefused(f"The kind of the goal is {message.kind}, but must be JOINTS, POSE or NAMED.")
    try:
        return MoveGoal(pose_in(base, message.pose), message.straight, message.velocity)
    except ValueError as error:
        raise MoveRefused(f"The tool pose is refused: {error}.") from error

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
from kuka_control.model.switches import SwitchReply
from kuka_msgs.msg import MoveAction, MoveFeedback, MoveResult
from kuka_msgs.msg import MoveGoal as MoveGoalMessage

FEEDBACK_S = 0.1  # period of the feedback [s]
REFUSAL_S = 0.15  # the robot refuses a motion within this time after its word [s]
START_S = 1.0  # the control loop has this long to start or refuse a motion [s]


class MoveServer:
    """Offers kuka/move: one motion at a time; another goal meanwhile is rejected. `read` returns the last step of the
    control loop, None before the first, and the measured joints, shape (7,); `move` is the motion that the control loop
    is to make, None while nothing is asked for; `stops`: the robot can stop a point-to-point motion;
    `unguided`: why no hand can guide the arm, a part of a sentence."""

    def __init__(
        self,
        planner: MovePlanner,
        read: Callable[[], tuple[Step | None, np.ndarray]],
        frames: ArmFrames = ONE_ARM,
        stops: bool = False,
        unguided: str | None = "robot_server is toolbox; only leap_rig can be guided by hand",
    ) -> None:
        self.move: ProgramMotion | None = None
        self._base = frames(BASE)
        self._stops, self._unguided = stops, unguided
        self._planner = planner
        self._read = read
        self._lock = clock.Lock()
        self._handle: actionlib.ServerGoalHandle | None = None
        self._number = 0
        self._verdict: clock.SimpleQueue[str | None] | None = None  # gets why it does not begin, or None
        self._due = self._asked = 0.0  # when the next feedback is due, and when the goal came [s]
        self._sure = 0.0  # until when the robot may refuse what the control loop has begun [s]
        server = actionlib.ActionServer("kuka/move", MoveAction, self._goal, self._cancel, auto_start=False)
        server.start()

    def show(self, step: Step, joints: np.ndarray) -> None:
        """Reports what has become of the motion; called by the control loop after each cycle."""
        move, handle, progress, now = self.move, self._handle, step.move, clock.monotonic()
        if move is None:
            return
        if progress is None or progress.number != move.number:
            if now - self._asked > START_S:
                self.abort(f"The controller did not start the motion. {step.reason}")
        elif progress.state is MoveState.RUNNING:
            self._sure = now + REFUSAL_S if step.transitions else self._sure
            if move.guided and now < self._sure:
                return
            self._tell(None)
            if now >= self._due and handle is not None:
                self._due = now + FEEDBACK_S
                handle.publish_feedback(MoveFeedback(progress.fraction, progress.left, joints.tolist()))
        else:
            self._end(progress.state, progress.sentence, joints)

    def abort(self, sentence: str) -> None:
        """Ends what was asked for, because the control loop has stopped."""
        if self.move is not None:
            self._end(MoveState.ABORTED, sentence, self._read()[1])

    def _end(self, state: MoveState, sentence: str, joints: np.ndarray) -> None:
        with self._lock:
            handle, self._handle, self.move = self._handle, None, None
            self._tell(None if state is MoveState.DONE else sentence)  # before another one may ask
        result = MoveResult(state is MoveState.DONE, sentence, joints.tolist())
        if handle is not None:
            ends = {MoveState.DONE: handle.set_succeeded, MoveState.CANCELLED: handle.set_canceled}
            ends.get(state, handle.set_aborted)(result, sentence)
        (rospy.loginfo if result.success else rospy.logwarn)("kuka/move: %s", sentence)

    def _tell(self, refusal: str | None) -> None:
        verdict, self._verdict = self._verdict, None
        if verdict is not None:
            verdict.put(refusal)

    def _goal(self, handle: actionlib.ServerGoalHandle) -> None:
        message, joints = handle.get_goal(), self._read()[1]
        try:
            guided = message.kind == MoveGoalMessage.GUIDED
            number, joints = self._begin(guided)
            goal = None if guided else _goal_of(message, self._base)
            move = self._guided(number, joints) if goal is None else self._planner.plan(number, goal, joints)
            self._ask(move, handle)
        except Exception as error:  # also what nobody expects must end the goal: the program waits for it
            known = isinstance(error, MoveRefused)
            sentence = str(error) if known else f"The motion cannot be planned: {type(error).__name__}: {error}."
            handle.set_rejected(MoveResult(False, sentence, joints.tolist()), sentence)
            rospy.logwarn("kuka/move: %s", sentence)

    def guide(self, on: bool) -> SwitchReply:
        """Lets a hand guide the arm, or ends that; waits until the control loop and the robot have begun it."""
        if not on:
            self._end_guiding(self.move)
            return SwitchReply(True, "No hand guides the arm any more.")
        verdict: clock.SimpleQueue[str | None] = clock.SimpleQueue()
        move = None
        try:
            move = self._guided(*self._begin(True))
            self._ask(move, verdict=verdict)
            refusal = verdict.get(timeout=2.0 * START_S)
        except MoveRefused as error:
            refusal = str(error)
        except clock.Empty:
            refusal = f"The controller has done nothing for {2.0 * START_S:g} s; the hand guiding is cancelled."
            self._end_guiding(move)
        if refusal is not None:
            return SwitchReply(False, refusal)
        return SwitchReply(True, "Hold the enabling switch and move the arm; its release ends that.")

    def _end_guiding(self, move: ProgramMotion | None) -> None:
        with self._lock:
            if move is not None and move.guided and move is self.move:
                self.move = replace(move, cancelled=True)

    @property
    def guided(self) -> bool:
        """Whether a hand may guide the arm."""
        move, step = self.move, self._read()[0]
        progress = None if step is None else step.move
        return move is not None and move.guided and progress is not None and progress.number == move.number

    def _begin(self, guided: bool) -> tuple[int, np.ndarray]:
        """Returns the number of the next motion, and the joints of the arm; raises MoveRefused."""
        with self._lock:
            self._refuse_second()
            self._number += 1
            number = self._number
        step, joints = self._read()
        if step is None or step.mode not in READY:
            raise MoveRefused("The controller starts." if step is None else wrong_time(step.mode, step.reason, guided))
        return number, joints

    def _ask(
        self,
        move: ProgramMotion,
        handle: actionlib.ServerGoalHandle | None = None,
        verdict: clock.SimpleQueue[str | None] | None = None,
    ) -> None:
        """Asks the control loop for a motion; raises MoveRefused: another one was asked for while this was planned."""
        with self._lock:
            self._refuse_second()
            if handle is not None:
                handle.set_accepted()
            self._asked, self._handle, self._verdict, self.move = clock.monotonic(), handle, verdict, move

    def _refuse_second(self) -> None:
        if self.move is not None:
            raise MoveRefused("The motion before has not ended; cancel it or wait.")

    def _guided(self, number: int, joints: np.ndarray) -> ProgramMotion:
        if self._unguided is not None:
            raise MoveRefused(f"Hand guiding is refused: {self._unguided}.")
        return ProgramMotion(number, "the place where the hand left it", joints, 0.0, guided=True)

    def _cancel(self, handle: actionlib.ServerGoalHandle) -> None:
        with self._lock:
            move = self.move
            if handle != self._handle or move is None:
                return
            self.move = replace(move, cancelled=True)
        if move.line is None and not (move.guided or self._stops):
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

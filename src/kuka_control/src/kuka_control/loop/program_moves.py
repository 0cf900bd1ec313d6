"""The motion that a program asks a control loop for: whether it may begin, how far it is, and how it ended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from common.modes import Mode
from kuka_control.limits.line_plan import LinePlan
from kuka_control.loop.moves import MoveProgress, MoveState, ProgramMotion, mover, wrong_time
from kuka_control.loop.transitions import State, Trigger
from kuka_control.numbers import LINE_START_RAD


class ProgramMoves:
    """Takes each motion that is asked for once, in the order of their numbers.

    Attributes:
        motion: the last one that began, or was to begin; None before the first.
        progress: of the last one that was asked for; None before the first.
        cancelled: whether the program has cancelled `motion`."""

    def __init__(self, lines: bool) -> None:
        """`lines`: whether the loop makes straight lines."""
        self.motion: ProgramMotion | None = None
        self.progress: MoveProgress | None = None
        self.cancelled = False
        self._lines = lines
        self._newest: ProgramMotion | None = None  # that the inputs bring
        self._q_begin = np.zeros(7)  # joints where `motion` began [rad]

    @property
    def running(self) -> ProgramMotion:
        """`motion`, in a state that has one."""
        assert self.motion is not None, "a motion was asked for"
        return self.motion

    @property
    def line(self) -> LinePlan:
        """That of `motion`, in a state that has one."""
        line = self.running.line
        assert line is not None, "a line was asked for"
        return line

    def take(self, newest: ProgramMotion | None) -> None:
        """Takes what the inputs of a cycle bring."""
        self._newest = newest
        same = newest is not None and self.motion is not None and newest.number == self.motion.number
        self.cancelled = newest is None or newest.cancelled or not same

    def begin(self, joints: np.ndarray, control_on: bool, stream_runs: bool) -> Trigger | None:
        """Returns the trigger of the requested motion, or None if no motion is requested or it is refused. `joints` of
        the arm at rest, shape (7,) [rad]; `stream_runs`: desired tool frames come."""
        move = self._asked()
        if move is None:
            return None
        refusal = self._refusal(move, joints, control_on, stream_runs)
        if refusal is not None:
            self.progress = MoveProgress(move.number, MoveState.REFUSED, refusal)
            return None
        self.motion = move
        self.progress = MoveProgress(move.number, MoveState.RUNNING)
        self._q_begin = joints
        return Trigger.GUIDE if move.guided else Trigger.MOVE if move.line is None else Trigger.LINE

    def refuse(self, sentence: str) -> None:
        """A body is in the way of the motion that was to begin."""
        assert self.progress is not None, "a motion was asked for"
        self.progress = replace(self.progress, state=MoveState.REFUSED, sentence=sentence)

    def advance(self, joints: np.ndarray, of_line: float) -> None:
        """Notes how far the running motion is; `of_line`: the fraction of its line that is done."""
        assert self.progress is not None, "a motion runs"
        move = self.running
        if move.guided:
            return
        if move.line is not None:
            fraction = of_line
            left = (1.0 - fraction) * move.line.length
        else:
            way, left = (float(np.max(np.abs(move.q - q))) for q in (self._q_begin, joints))
            fraction = 1.0 - min(left / way, 1.0) if way > 0.0 else 1.0
        self.progress = replace(self.progress, fraction=fraction, left=left)

    def refuse_late(self, mode: Mode, reason: str, checks: bool) -> None:
        """Refuses a motion that came at the wrong time, in a mode that has a reason; `checks`: the path of one that
        is to begin is still being checked."""
        asked = self._asked()
        if asked is not None and not (checks and asked is self.motion):
            self.progress = MoveProgress(asked.number, MoveState.REFUSED, wrong_time(mode, reason, asked.guided))

    def end(self, target: State, cause: Trigger | None, because: str) -> None:
        """The running motion ends by `cause` with a transition to `target`."""
        assert self.progress is not None, "a motion runs"
        move = self.running
        if target is State.AT_GOAL and cause is Trigger.ARRIVED:
            late = " It was cancelled on the way, but a point-to-point motion ends at its goal."
            sentence = f"The arm is at {move.name}.{late if move.line is None and self.cancelled else ''}"
            self.progress = replace(self.progress, state=MoveState.DONE, sentence=sentence, fraction=1.0, left=0.0)
        else:
            state = MoveState.CANCELLED if cause is Trigger.CANCELLED else MoveState.ABORTED
            self.progress = replace(self.progress, state=state, sentence=because)

    def _asked(self) -> ProgramMotion | None:
        """Returns the motion that a program asks for, if it was neither started nor refused before."""
        move = self._newest
        known = self.progress
        if move is None or known is None or move.number > known.number:
            return move
        checked = move.number == known.number and known.state is MoveState.RUNNING
        return move if checked else None

    def _refusal(self, move: ProgramMotion, joints: np.ndarray, control_on: bool, stream_runs: bool) -> str | None:
        if move.cancelled:
            return "The motion was cancelled before it began."
        if not control_on:
            return f"Control is off; {mover(move.guided)} the arm only while the operator has switched it on."
        if stream_runs:
            who = mover(move.guided)
            return f"The desired tool frame comes from a tracked hand or a node; end that before {who} the arm."
        if move.line is None:
            return None
        if not self._lines:
            return "This controller makes no straight lines."
        if np.max(np.abs(move.line.q_start - joints)) > LINE_START_RAD:
            return "The arm is no longer where the line begins; ask again."
        return None

"""One run of the toolbox's server application, from its start to the command `end`. No sockets; time is handed in.

The real program has two threads that share one command word. The reader answers goals, joint positions and outputs at
any time. The main thread answers the other commands one by one and wipes the word afterwards: commands that arrive
while it moves the arm are lost, but for the last one during a guarded motion. Here both are rules of one object.
Source: docs/handbook/wire-protocols.md, "Arm: Sunrise Toolbox"."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Callable, List, Optional

import numpy as np

from rig_simulation.devices.sunrise import java_text, motions
from rig_simulation.devices.sunrise.arm import SimulatedArm
from rig_simulation.devices.sunrise.motions import Goals, finite, frame_from_pose, overwritten, pose_from_frame
from rig_simulation.devices.sunrise.paths import JointMove, Unreachable

DONE, NAK, INTERRUPTED = "done\n", "nak\n", "interrupted\n"
LAST_WORD_S = 0.016  # from the acceptance of a motion to its last word, at least; measured on the published server
INPUT_PINS = (3, 4, 10, 13, 16)
VERSIONS = ("1.7", "2019-03", "2019-05")
"""Versions of the server, newest last: 1.7 of 2018, and the two states of the LTS that differ on the wire."""

Command = Callable[[List[str]], str]  # takes the words of a line behind its command; returns what to answer at once
Planner = Callable[[SimulatedArm, Goals], Optional[JointMove]]
Condition = Callable[[SimulatedArm], bool]
Break = Callable[[SimulatedArm], str]  # returns what breaks the motion, empty: nothing


@dataclasses.dataclass
class ControllerIO:
    """State that outlives a client: outputs of the flange, and the number of servo goals received."""

    outputs: dict[str, bool] = dataclasses.field(default_factory=dict)
    goals: int = 0


class Application:
    """Answers lines until `end` was received (`ended`): of the toolbox's commands those that kst sends. The `mode` is
    idle, ptp or servo, which lasts from the answer to its start until the arm is at rest again."""

    def __init__(
        self,
        arm: SimulatedArm,  # moved by this application alone; its tool is detached
        io: ControllerIO,
        wiped_window: float = 0.0,  # time after an answer of the main thread in which its commands are lost [s]
        encoders: Callable[[np.ndarray], np.ndarray] = lambda q: q,  # true to reported angles, shape (7,) [rad]
        version: str = VERSIONS[-1],
        refuses: Callable[[], bool] = lambda: False,  # whether every motion is refused
        ends_tacitly: Callable[[], bool] = lambda: False,  # whether the end of a motion is not answered
    ) -> None:
        self.mode = "idle"
        self.ended = False
        self._arm = arm
        self._io = io
        self._wiped_window = wiped_window
        self._encoders = encoders
        self._version = version
        self._refuses = refuses
        self._ends_tacitly = ends_tacitly
        self._replies: list[str] = []
        self._reader_alive = self._main_alive = True
        self._main_answered = self._now = -np.inf
        self._goals = Goals()
        self._accepted: Planner | None = None  # of the motion to start
        self._refused = False  # the motion, and its last word is to come
        self._last_word = -math.inf  # not before this time [s]
        self._word, self._keeps_word = "", False  # the last line; whether a motion leaves it to the main thread
        self._break_when: Break | None = None
        self._arrived: Condition = lambda _: True
        self._servo_starts: float | None = None
        self._reader = self._reader_commands()
        self._main = self._main_commands()
        arm.attach(np.eye(4))

    @property
    def busy(self) -> bool:
        """Whether the main thread moves the arm."""
        return self.mode != "idle"

    @property
    def in_motion(self) -> bool:
        """Whether a planned motion is under way or about to start."""
        return self._accepted is not None or self._arm.in_motion

    def receive(self, line: str, now: float) -> str:
        """Takes one line without its end at the time `now` [s]; returns the text to send."""
        self._advance(now)
        if self._reader_alive and not self.ended and line:
            self._answer(line)
        return self._take_replies()

    def advance(self, now: float) -> str:
        """Advances to the time `now` [s]; returns the text to send by then."""
        self._advance(now)
        return self._take_replies()

    def abandon(self) -> None:
        """Stops motion and servo mode when the client is gone; the arm brakes."""
        self._accepted = None
        self._arm.break_motion()
        self._stop_servo()

    def _take_replies(self) -> str:
        text = "".join(self._replies)
        self._replies.clear()
        return "" if self.ended else text

    def _answer(self, line: str) -> None:
        words, self._word = _words(line), line
        for prefix, command in self._reader:
            if line.startswith(prefix):
                self._replies.append(command(words))
                return
        self._answer_in_main(line, words)

    def _answer_in_main(self, line: str, words: list[str]) -> None:
        for prefix, command in self._main:
            if line == prefix if prefix.startswith("Eef_") else line.startswith(prefix):
                if self._main_alive and not self.busy and self._now >= self._main_answered + self._wiped_window:
                    self._main_answered = self._now
                    try:
                        self._replies.append(command(words))
                    except (ValueError, IndexError):
                        self._forget_tool()
                        self._replies.append(NAK)
                return

    def _advance(self, now: float) -> None:
        self._now = now
        if self._servo_starts is not None and now >= self._servo_starts:
            self._arm.advance(self._servo_starts)
            self._begin_servo()
        self._arm.advance(now)
        if self._accepted is not None:
            self._start_motion(self._accepted)
        if self.mode == "ptp" and not self.in_motion and now >= self._last_word:
            self._finish_motion(now)
        elif self.mode == "servo" and self._servo_starts is None and not self._arm.in_servo and self._arm.resting:
            self.mode = "idle"

    def _finish_motion(self, now: float) -> None:
        self.mode = "idle"
        if not self._ends_tacitly():
            self._replies.append(self._result())
        if self._keeps_word and not self._refused:
            self._answer_in_main(self._word, _words(self._word))
        else:
            self._main_answered = now

    def _result(self) -> str:
        """Returns the last word of the motion that has ended or is refused."""
        return NAK if self._refused else DONE if self._arrived(self._arm) else INTERRUPTED

    def _forget_tool(self) -> None:
        """Attaches the flange, as the published server does after whatever it refuses."""
        self._arm.attach(np.eye(4))

    def _reader_commands(self) -> list[tuple[str, Command]]:
        output_pins = (1, 2, 11, 12)
        arm, newest = self._arm, self._version == VERSIONS[-1]
        feedback: dict[str, Callable[[], str]] = {
            "ExT_": lambda: _line(arm.external_torques),
            "MT_": lambda: _line(arm.measured_torques),
            "JP_": self._joints,
            **({"EEfP_": self._tool, "EEfFrelEEF_": self._force} if newest else {"EEfP_": self._force}),
        }
        commands: list[tuple[str, Command]] = [
            ("end", self._end),
            *((f"jp{suffix}", partial(self._take_goal, answer)) for suffix, answer in feedback.items()),
            ("jp_", partial(self._take_goal, lambda: DONE)),
            ("jf_", partial(self._take_goal, lambda: "")),
            ("stopDirectServoJoints", self._stop),
            ("getJointsPositions", self._joints),
            *((f"getPin{n}", lambda _: "1\n\n") for n in INPUT_PINS),
        ]
        switches = [("blueOn", "blueOff", "blue"), *((f"pin{n}on", f"pin{n}off", f"pin{n}") for n in output_pins)]
        for on, off, name in switches:
            commands += [(on, partial(self._output, name, True)), (off, partial(self._output, name, False))]
        return commands

    def _main_commands(self) -> list[tuple[str, Command]]:
        arm = self._arm
        return [
            ("TFtrans", self._attach),
            ("jRelVel_", self._set_speed),
            ("doPTPinJS", lambda _: self._move(motions.joint_motion)),
            ("doPTP!inJS", self._guarded_joint_motion),
            ("startDirectServoJoints", self._start_servo),
            ("Torques_ext_J", lambda _: _line(arm.external_torques)),
            ("Torques_m_J", lambda _: _line(arm.measured_torques)),
            ("Eef_pos", self._tool),
            ("Eef_force", self._force),
            ("Eef_moment", lambda _: _line(arm.tool_moment)),
        ]

    def _joints(self, *_: list[str]) -> str:
        return _line(self._encoders(self._arm.q))

    def _tool(self, *_: list[str]) -> str:
        return _line(frame_from_pose(self._arm.tool))

    def _force(self, *_: list[str]) -> str:
        return _line(self._arm.tool_force)

    def _take_goal(self, answer: Callable[[], str], words: list[str]) -> str:
        reply = answer()
        try:
            self._goals.joints = goal = overwritten(self._goals.joints, words)
        except ValueError:
            self._reader_alive = False
            return ""
        if self._arm.in_servo:
            self._arm.goal = goal
            self._io.goals += 1
        return reply

    def _stop(self, _: list[str]) -> str:
        self._stop_servo()
        return DONE

    def _stop_servo(self) -> None:
        self._servo_starts = None
        self._arm.stop_servo()

    def _end(self, _: list[str]) -> str:
        self._stop_servo()
        self.ended = True
        return ""

    def _output(self, name: str, on: bool, _: list[str]) -> str:
        self._io.outputs[name] = on
        return DONE

    def _attach(self, words: list[str]) -> str:
        if len(words) < 6:
            self._main_alive = False
        if len(words) != 6:
            raise ValueError
        self._arm.attach(pose_from_frame(finite(words)))
        return DONE

    def _set_speed(self, words: list[str]) -> str:
        self._goals.speed = java_text.number(words[0])
        return DONE

    def _move(self, make: Planner, break_when: Break | None = None, arrived: Condition = lambda _: True) -> str:
        """Accepts the motion; before the next line it is planned, and starts or is refused."""
        self.mode, self._refused, self._keeps_word, self._word = "ptp", False, False, ""
        self._last_word = self._now + LAST_WORD_S
        self._break_when, self._arrived = break_when, arrived
        self._accepted = make
        return DONE

    def _start_motion(self, make: Planner) -> None:
        refusal_s = 0.052  # from the acceptance of a motion to its refusal; measured on the published server
        self._accepted = None
        try:
            if self._refuses():
                raise Unreachable("the motion is refused")
            motion = make(self._arm, self._goals)
        except ValueError:
            self._forget_tool()
            self._refused = True
            self._last_word += refusal_s - LAST_WORD_S
            return
        if motion is not None:
            self._arm.start_motion(motion, self._break_when)

    def _guarded_joint_motion(self, words: list[str]) -> str:
        target = self._goals.joints
        ranges = finite(words).reshape(-1, 3)  # raises ValueError for an incomplete range, too
        if len(ranges) > 7:
            raise ValueError(f"{len(ranges)} ranges")
        unknown = [joint for joint in ranges[:, 0] if not 0 <= int(joint) <= 6]

        def guarded(arm: SimulatedArm, goals: Goals) -> JointMove | None:
            if unknown:
                raise Unreachable(f"there are no joints {unknown}")
            return motions.joint_motion(arm, goals) if len(ranges) else None

        def arrived(arm: SimulatedArm) -> bool:
            return not len(ranges) or motions.arrived_at_joints(arm, target)

        reply = self._move(guarded, motions.leaves_torque_ranges(ranges), arrived)
        self._keeps_word = True  # the published server wipes the word before such a motion, not after it
        return reply

    def _start_servo(self, _: list[str]) -> str:
        # from the answer to a start until the mode runs; goal: the present joints, earlier goals are lost
        servo_start_s = 0.1
        self.mode = "servo"
        self._servo_starts = self._now + servo_start_s
        return DONE

    def _begin_servo(self) -> None:
        self._servo_starts = None
        self._arm.start_servo()
        self._goals.joints = self._arm.goal


def _words(line: str) -> list[str]:
    return [word for word in line.split("_") if word][1:]


def _line(values: np.ndarray) -> str:
    return f"{java_text.vector(values)}\n"

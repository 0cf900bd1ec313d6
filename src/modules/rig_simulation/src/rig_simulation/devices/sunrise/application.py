"""One run of the toolbox's server application, from its start to the command `end`. No sockets; time is handed in.

The real program has two threads that share one command word. The reader answers goals, joint positions and outputs at
any time. The main thread answers the other commands one by one and wipes the word afterwards: commands that arrive
while it moves the arm are lost, but for the last one during a guarded motion. Here both are rules of one object.
Source: docs/handbook/wire-protocols.md, "Arm: Sunrise Toolbox".
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Callable, List, Optional, Protocol

import numpy as np

from rig_simulation.devices.sunrise import java_text, motions
from rig_simulation.devices.sunrise.arm import SimulatedArm
from rig_simulation.devices.sunrise.motions import Goals, finite, frame_from_pose, overwritten, pose_from_frame
from rig_simulation.devices.sunrise.paths import PlannedMotion, Unreachable

DONE, NAK, INTERRUPTED = "done\n", "nak\n", "interrupted\n"
LAST_WORD_S = 0.016  # from the acceptance of a motion to its last word, at least; measured on the published server
REFUSAL_S = 0.052  # from the acceptance of a motion to its refusal, likewise
SERVO_START_S = 0.1  # from the answer to a start until the mode runs; goal: the present joints, earlier goals are lost
IMPEDANCE_FRACTION = 0.1
IMPEDANCE_MAX_TORQUE_NM = 10.0
MAX_STIFFNESS = (5000.0, 300.0)
INPUT_PINS = (3, 4, 10, 13, 16)
OUTPUT_PINS = (1, 2, 11, 12)
VERSIONS = ("1.7", "2019-03", "2019-05")
"""Versions of the server, newest last: 1.7 of 2018, and the two states of the LTS that differ on the wire."""

Command = Callable[[List[str]], str]  # takes the words of a line behind its command; returns what to answer at once
Planner = Callable[[SimulatedArm, Goals], Optional[PlannedMotion]]
Condition = Callable[[SimulatedArm], bool]


class MotionPlan(Protocol):
    """A motion that is being planned, as a Future of `concurrent.futures`."""

    def done(self) -> bool:
        """Returns whether `result` returns at once."""

    def result(self) -> PlannedMotion | None:
        """Returns the motion, None if the arm is at its target already; raises ValueError if it cannot be planned."""


@dataclasses.dataclass(frozen=True)
class PlanWhenAsked:
    """Plans where the result is asked for, which is at the next advance."""

    result: Callable[[], PlannedMotion | None]

    def done(self) -> bool:
        return True


@dataclasses.dataclass
class ControllerIO:
    """State that outlives a client: outputs of the flange, and the number of servo goals received."""

    outputs: dict[str, bool] = dataclasses.field(default_factory=dict)
    goals: int = 0


class Application:
    """Answers lines until `end` was received (`ended`). The `mode` is idle, ptp, servo, cartesian_servo, velocity_servo
    or impedance_servo; a servo mode lasts from the answer to its start until the arm is at rest again.
    """

    def __init__(
        self,
        arm: SimulatedArm,  # moved by this application alone; its tool is detached
        io: ControllerIO,
        wiped_window: float = 0.0,  # time after an answer of the main thread in which its commands are lost [s]
        encoders: Callable[[np.ndarray], np.ndarray] = lambda q: q,  # true to reported angles, shape (7,) [rad]
        version: str = VERSIONS[-1],
        # Begins to plan a motion; the function may be called in another thread
        begin_plan: Callable[[Callable[[], PlannedMotion | None]], MotionPlan] = PlanWhenAsked,
        ends_tacitly: Callable[[], bool] = lambda: False,  # whether the end of a motion is not answered
    ) -> None:
        self.mode = "idle"
        self.ended = False
        self._arm = arm
        self._io = io
        self._wiped_window = wiped_window
        self._encoders = encoders
        self._version = version
        self._begin_plan, self._ends_tacitly = begin_plan, ends_tacitly
        self._replies: list[str] = []
        self._reader_alive = self._main_alive = True
        self._main_answered = self._now = -np.inf
        self._goals = Goals()
        self._plan: MotionPlan | None = None
        self._accepted: Callable[[SimulatedArm], PlannedMotion | None] | None = None  # plans the motion to start
        self._planned_from = arm.q
        self._refused = False  # the motion, and its last word is to come
        self._last_word = -math.inf  # not before this time [s]
        self._word, self._keeps_word = "", False  # the last line; whether a motion leaves it to the main thread
        self._break_when: Condition | None = None
        self._arrived: Condition = lambda _: True
        self._servo_starts: float | None = None
        self._servo_stopping = False
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
        self._accepted = self._plan = None
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
                        self._arm.attach(np.eye(4))
                        self._replies.append(NAK)
                return

    def _advance(self, now: float) -> None:
        self._now = now
        if self._servo_starts is not None and now >= self._servo_starts:
            self._arm.advance(self._servo_starts)
            self._begin_servo()
        self._arm.advance(now)
        if self._accepted is not None:
            self._plan_motion(self._accepted)
        if self.mode == "ptp" and not self.in_motion and now >= self._last_word:
            self.mode = "idle"
            arrived = NAK if self._refused else DONE if self._arrived(self._arm) else INTERRUPTED
            if not self._ends_tacitly():
                self._replies.append(arrived)
            if self._keeps_word and not self._refused:
                self._answer_in_main(self._word, _words(self._word))
            else:
                self._main_answered = now
        elif self.mode.endswith("servo") and self._servo_starts is None and not self._arm.in_servo:
            if self.mode == "impedance_servo" and not self._servo_stopping:
                self._replies.append(DONE)
            self._servo_stopping = True
            if self._arm.resting:
                self.mode = "idle"

    def _reader_commands(self) -> list[tuple[str, Command]]:
        arm, newest = self._arm, self._version == VERSIONS[-1]
        feedback: dict[str, Callable[[], str]] = {
            "ExT_": lambda: _line(arm.external_torques),
            "MT_": lambda: _line(arm.measured_torques),
            "JP_": self._joints,
            **({"EEfP_": self._tool, "EEfFrelEEF_": self._force} if newest else {"EEfP_": self._force}),
        }
        take_pose = self._refuse_goal if self._version == "1.7" else self._take_pose
        commands: list[tuple[str, Command]] = [
            ("end", self._end),
            *((f"jp{suffix}", self._goal(self._take_joints, answer)) for suffix, answer in feedback.items()),
            ("jp_", self._goal(self._take_joints, lambda: DONE)),
            ("jf_", self._goal(self._take_joints, lambda: "")),
            *((f"DcSeCar{suffix}", self._goal(take_pose, answer)) for suffix, answer in feedback.items()),
            ("DcSeCar_", self._goal(self._take_pose, lambda: "")),
            *((f"velJDC{s}", self._goal(self._take_speeds, feedback[s])) for s in ("ExT_", "MT_", "JP_", "EEfP_")),
            ("velJDC_", self._goal(self._take_speeds, lambda: DONE)),
            ("cArtixanPositionCirc1_", partial(self._keep_pose, "via")),
            ("cArtixanPositionCirc2_", partial(self._keep_pose, "end")),
            ("cArtixanPosition_", partial(self._keep_pose, "target")),
            ("stopDirectServoJoints", self._stop),
            ("getJointsPositions", self._joints),
            *((f"getPin{n}", lambda _: "1\n\n") for n in INPUT_PINS),
        ]
        switches = [("blueOn", "blueOff", "blue"), *((f"pin{n}on", f"pin{n}off", f"pin{n}") for n in OUTPUT_PINS)]
        for on, off, name in switches:
            commands += [(on, partial(self._output, name, True)), (off, partial(self._output, name, False))]
        return commands

    def _main_commands(self) -> list[tuple[str, Command]]:
        arm = self._arm
        return [
            ("TFtrans", self._attach),
            ("jRelVel_", self._set_speed),
            ("doPTPinJS", lambda _: self._move(motions.joint_motion)),
            ("doPTPinCSRelBase", lambda _: self._move(partial(motions.relative_line, along_tool=False))),
            ("doPTPinCSRelEEF", lambda _: self._move(partial(motions.relative_line, along_tool=True))),
            ("doPTPinCSCircle1", lambda _: self._move(motions.circle)),
            ("doPTPinCS", lambda _: self._move(motions.line)),
            ("doPTP!inJS", self._guarded_joint_motion),
            ("doPTP!inCS", self._guarded_line),
            ("doPTP!CSCircle1", self._guarded_joint_motion),
            ("startDirectServoJoints", lambda _: self._start_servo("servo")),
            ("stDcEEf_", lambda _: self._start_servo("cartesian_servo")),
            ("stVelDcJoint_", lambda _: self._start_servo("velocity_servo")),
            ("startSmartImpedneceJoints", self._start_impedance),
            ("Torques_ext_J", lambda _: _line(arm.external_torques)),
            ("Torques_m_J", lambda _: _line(arm.measured_torques)),
            ("Eef_pos", self._tool),
            ("Eef_force", self._force),
            ("Eef_moment", lambda _: _line(arm.tool_moment)),
            *((name, lambda _: DONE) for name in ("handGuiding", "preciseHandGuiding1", "preciseHandGuiding2")),
        ]

    def _joints(self, *_: list[str]) -> str:
        return _line(self._encoders(self._arm.q))

    def _tool(self, *_: list[str]) -> str:
        return _line(frame_from_pose(self._arm.tool))

    def _force(self, *_: list[str]) -> str:
        return _line(self._arm.tool_force)

    def _goal(self, take: Callable[[list[str]], bool], answer: Callable[[], str]) -> Command:
        def command(words: list[str]) -> str:
            reply = answer()
            if not take(words):
                self._reader_alive = False
                return ""
            self._io.goals += self._arm.in_servo
            return reply

        return command

    def _take_joints(self, words: list[str]) -> bool:
        try:
            self._goals.joints = goal = overwritten(self._goals.joints, words)
        except ValueError:
            return False
        if self._arm.in_servo and self.mode in ("servo", "impedance_servo"):
            self._arm.goal = goal
        return True

    def _take_speeds(self, words: list[str]) -> bool:
        speeds, valid = self._take_numbers(words, self._goals.speeds)
        if speeds is not None:
            self._goals.speeds = speeds
            if self._arm.in_servo and self.mode == "velocity_servo":
                self._arm.goal_speed = speeds
        return valid

    def _take_pose(self, words: list[str]) -> bool:
        frame, valid = self._take_numbers(words, self._goals.servo)
        if frame is not None:
            self._goals.servo = frame
            if self._arm.in_servo and self.mode == "cartesian_servo":
                goal = None
                if np.all(np.isfinite(frame)):
                    goal = self._arm.robot.solve(pose_from_frame(frame), self._arm.T_flange_tool, self._arm.goal)
                if goal is None:
                    self._stop_servo()
                else:
                    self._arm.goal = goal
        return valid

    def _take_numbers(self, words: list[str], before: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """Returns None and False for too many words, which end the reader thread; an invalid number ends the mode."""
        if len(words) > len(before):
            return None, False
        try:
            return overwritten(before, words), True
        except ValueError:
            self._stop_servo()
            return None, True

    def _refuse_goal(self, _: list[str]) -> bool:
        """Ends the mode, as version 1.7 does: it parses Cartesian goals that ask for an answer as joints."""
        self._stop_servo()
        return True

    def _keep_pose(self, name: str, words: list[str]) -> str:
        try:
            setattr(self._goals, name, overwritten(getattr(self._goals, name), words))
        except ValueError:
            self._reader_alive = False
            return ""
        return DONE

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

    def _move(self, make: Planner, break_when: Condition | None = None, arrived: Condition = lambda _: True) -> str:
        """Accepts the motion; it is planned afterwards, and starts or is refused."""
        self.mode, self._refused, self._keeps_word, self._word = "ptp", False, False, ""
        self._last_word = self._now + LAST_WORD_S
        self._break_when, self._arrived = break_when, arrived
        goals = dataclasses.replace(self._goals)  # as they are now
        self._accepted = lambda arm: make(arm, goals)
        return DONE

    def _plan_motion(self, make: Callable[[SimulatedArm], PlannedMotion | None]) -> None:
        arm = self._arm
        if self._plan is not None and self._plan.done() and not np.array_equal(self._planned_from, arm.q):
            self._plan = None  # of an arm that backed off meanwhile
        if self._plan is None:
            self._planned_from = arm.q
            self._plan = self._begin_plan(partial(make, arm.snapshot()))
        if self._plan.done():
            self._start_motion(self._plan)

    def _start_motion(self, plan: MotionPlan) -> None:
        self._accepted = self._plan = None
        try:
            motion = plan.result()
        except ValueError:
            self._arm.attach(np.eye(4))
            self._refused = True
            self._last_word += REFUSAL_S - LAST_WORD_S
            return
        if motion is not None:
            self._arm.start_motion(motion, self._break_when)

    def _guarded_joint_motion(self, words: list[str]) -> str:
        target = self._goals.joints
        return self._guarded(words, motions.joint_motion, lambda arm: motions.arrived_at_joints(arm, target))

    def _guarded_line(self, words: list[str]) -> str:
        target = self._goals.target
        return self._guarded(words, motions.line, lambda arm: motions.arrived_at_pose(arm, pose_from_frame(target)))

    def _guarded(self, words: list[str], make: Planner, arrived: Condition) -> str:
        ranges = finite(words).reshape(-1, 3)  # raises ValueError for an incomplete range, too
        if len(ranges) > 7:
            raise ValueError(f"{len(ranges)} ranges")
        unknown = [joint for joint in ranges[:, 0] if not 0 <= int(joint) <= 6]

        def guarded(arm: SimulatedArm, goals: Goals) -> PlannedMotion | None:
            if unknown:
                raise Unreachable(f"there are no joints {unknown}")
            return make(arm, goals) if len(ranges) else None

        reply = self._move(guarded, motions.leaves_torque_ranges(ranges), arrived if len(ranges) else lambda _: True)
        self._keeps_word = True  # the published server wipes the word before such a motion, not after it
        return reply

    def _start_servo(self, mode: str) -> str:
        self.mode = mode
        self._servo_stopping = False
        self._servo_starts = self._now + SERVO_START_S
        return DONE

    def _start_impedance(self, words: list[str]) -> str:
        numbers = finite(words)
        if len(numbers) < 7:
            raise ValueError
        mass, stiffness = numbers[0], numbers[4:7]
        refused = mass < 0.0 or np.any(stiffness < 0.0) or np.any(stiffness[:2] > MAX_STIFFNESS)
        if refused or np.max(np.abs(self._arm.external_torques)) > IMPEDANCE_MAX_TORQUE_NM:
            return self._move(lambda arm, goals: None)
        return self._start_servo("impedance_servo")

    def _begin_servo(self) -> None:
        self._servo_starts = None
        arm = self._arm
        if self.mode == "servo":
            arm.start_servo()
            self._goals.joints = arm.goal
        elif self.mode == "cartesian_servo":
            arm.start_servo(law="none")
            self._goals.servo = frame_from_pose(arm.tool)
        elif self.mode == "velocity_servo":
            arm.start_servo(integrates=True)
            self._goals.speeds = arm.goal_speed
        else:
            # The published server does not reset the goal of joint 1 here: it stays what was sent last.
            arm.start_servo(law="none", fraction=IMPEDANCE_FRACTION)
            self._goals.joints = np.array([self._goals.joints[0], *arm.q[1:]])
            arm.goal = self._goals.joints


def _words(line: str) -> list[str]:
    return [word for word in line.split("_") if word][1:]


def _line(values: np.ndarray) -> str:
    return f"{java_text.vector(values)}\n"

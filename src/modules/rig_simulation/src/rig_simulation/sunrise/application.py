"""The toolbox server's application: one start of it, from its tool to `end`. No sockets; time is handed in.

The real program has two threads that share one command word. The reader answers goals, joint positions and outputs at
any time; the main thread answers the rest, one after the other, and wipes the word when it has done so: what reaches it
while it moves the arm is lost. Here both are rules of one object (reference: kst, 0, 2 and 3).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from common.poses import pose
from common.rotations import rotation_from_zyx, zyx_from_rotation
from rig_simulation.sunrise import java_numbers
from rig_simulation.sunrise.arm import Arm
from rig_simulation.sunrise.paths import Circle, Line, Unreachable, plan, shifted
from rig_simulation.sunrise.profiles import JointMove

DONE, NAK, INTERRUPTED = "done\n", "nak\n", "interrupted\n"
MM_PER_M = 1000.0
SERVO_START_S = 0.1
"""From the answer to a start until the mode runs and takes the present joints as goal; goals before that are lost."""
FIRST_RELATIVE_SPEED = 0.1
ARRIVED_JOINT_RAD = np.radians(0.1)
ARRIVED_TOOL_M = 2e-4
IMPEDANCE_SHARE = 0.1
IMPEDANCE_MAX_TORQUE_NM = 10.0
MAX_STIFFNESS = (5000.0, 300.0)
INPUT_PINS = (3, 4, 10, 13, 16)
OUTPUT_PINS = (1, 2, 11, 12)


@dataclasses.dataclass
class Panel:
    """What outlives a client: outputs of the flange, and how many servo goals came."""

    outputs: dict[str, bool] = dataclasses.field(default_factory=dict)
    goals: int = 0


class Application:
    """Answers lines.

    Args:
        arm: moved by this application alone; its tool is taken off.
        panel: outputs and counters.
        wiped_window: for so long after an answer of the main thread the next word for it is lost [s].

    Attributes:
        mode: idle, ptp, servo, cartesian_servo, velocity_servo or impedance_servo; a servo mode counts from the answer
            to its start until the arm stands again.
        ended: whether `end` came; nothing is answered any more.
    """

    def __init__(self, arm: Arm, panel: Panel, wiped_window: float = 0.0) -> None:
        self.mode = "idle"
        self.ended = False
        self._arm = arm
        self._panel = panel
        self._wiped_window = wiped_window
        self._replies: list[str] = []
        self._reader_alive = self._main_alive = True
        self._main_answered = -np.inf
        self._now = -np.inf
        self._joint_goal = np.zeros(7)
        self._speed_goal = np.zeros(7)
        self._poses = {name: np.zeros(6) for name in ("", "Circ1", "Circ2", "servo")}
        self._relative_speed = FIRST_RELATIVE_SPEED
        self._final_word: Callable[[], str] = lambda: DONE
        self._servo_starts: float | None = None
        self._servo_stopping = False
        self._reader = self._reader_commands()
        self._main = self._main_commands()
        arm.attach(np.eye(4))

    @property
    def busy(self) -> bool:
        """Whether the main thread moves the arm."""
        return self.mode != "idle"

    def receive(self, line: str, now: float) -> str:
        """Takes one line without its end at the time `now` [s]; returns the text that goes out because of it."""
        self._advance(now)
        if self._reader_alive and not self.ended and line:
            self._answer(line)
        return self._take_replies()

    def advance(self, now: float) -> str:
        """Moves on to the time `now` [s]; returns the text that goes out by then."""
        self._advance(now)
        return self._take_replies()

    def abandon(self) -> None:
        """Ends what moves the arm, because the client is gone; the arm brakes."""
        self._arm.break_motion()
        self._stop_servo()

    def _take_replies(self) -> str:
        text = "".join(self._replies)
        self._replies.clear()
        return "" if self.ended else text

    def _answer(self, line: str) -> None:
        words = [word for word in line.split("_") if word]
        for prefix, command in self._reader:
            if line.startswith(prefix):
                command(words[1:])
                return
        for prefix, command in self._main:
            if line == prefix if prefix.startswith("Eef_") else line.startswith(prefix):
                if self._main_alive and not self.busy and self._now >= self._main_answered + self._wiped_window:
                    self._main_answered = self._now
                    self._run_main(command, words[1:])
                return

    def _run_main(self, command: Callable[[list[str]], None], words: list[str]) -> None:
        try:
            command(words)
        except (ValueError, IndexError):
            self._refuse()

    def _refuse(self) -> None:
        self._arm.attach(np.eye(4))
        self._replies.append(NAK)

    def _advance(self, now: float) -> None:
        self._now = now
        if self._servo_starts is not None and now >= self._servo_starts:
            self._arm.advance(self._servo_starts)
            self._begin_servo()
        self._arm.advance(now)
        if self.mode == "ptp" and not self._arm.in_motion:
            self._finish(self._final_word())
        elif self.mode.endswith("servo") and self._servo_starts is None and not self._arm.in_servo:
            if self.mode == "impedance_servo" and not self._servo_stopping:
                self._replies.append(DONE)
            self._servo_stopping = True
            if self._arm.resting:
                self._finish(None)

    def _finish(self, word: str | None) -> None:
        self.mode = "idle"
        if word is not None:
            self._replies.append(word)

    def _reader_commands(self) -> list[tuple[str, Callable[[list[str]], None]]]:
        arm = self._arm
        feedback = {
            "ExT_": lambda: f"{java_numbers.vector(arm.external_torques)}\n",
            "MT_": lambda: f"{java_numbers.vector(arm.measured_torques)}\n",
            "JP_": self._joints_text,
            "EEfP_": self._tool_text,
            "EEfFrelEEF_": self._force_text,
        }
        commands = [
            ("end", self._end),
            *((f"jp{suffix}", self._goal(self._take_joints, answer)) for suffix, answer in feedback.items()),
            ("jp_", self._goal(self._take_joints, lambda: DONE)),
            ("jf_", self._goal(self._take_joints, lambda: "")),
            *((f"DcSeCar{suffix}", self._goal(self._take_pose, answer)) for suffix, answer in feedback.items()),
            ("DcSeCar_", self._goal(self._take_pose, lambda: "")),
            *((f"velJDC{s}", self._goal(self._take_speeds, feedback[s])) for s in ("ExT_", "MT_", "JP_", "EEfP_")),
            ("velJDC_", self._goal(self._take_speeds, lambda: DONE)),
            *((f"cArtixanPosition{name}_", self._keep_pose(name)) for name in ("Circ1", "Circ2", "")),
            ("stopDirectServoJoints", self._stop),
            ("getJointsPositions", lambda _: self._replies.append(self._joints_text())),
            ("blueOn", self._output("blue", True)),
            ("blueOff", self._output("blue", False)),
        ]
        commands += [(f"getPin{n}", lambda _: self._replies.append("1\n\n")) for n in INPUT_PINS]
        for n in OUTPUT_PINS:
            commands += [(f"pin{n}on", self._output(f"pin{n}", True)), (f"pin{n}off", self._output(f"pin{n}", False))]
        return commands

    def _main_commands(self) -> list[tuple[str, Callable[[list[str]], None]]]:
        def answer(text: Callable[[], str]) -> Callable[[list[str]], None]:
            return lambda _: self._replies.append(text())

        arm = self._arm
        return [
            ("TFtrans", self._attach),
            ("jRelVel_", self._set_speed),
            ("doPTPinJS", lambda _: self._move(self._joint_motion)),
            ("doPTPinCSRelBase", lambda _: self._move(lambda: self._line(self._relative(along_tool=False)))),
            ("doPTPinCSRelEEF", lambda _: self._move(lambda: self._line(self._relative(along_tool=True)))),
            ("doPTPinCSCircle1", lambda _: self._move(self._circle)),
            ("doPTPinCS", lambda _: self._move(lambda: self._line(self._pose("")))),
            ("doPTP!inJS", self._guarded(cartesian=False)),
            ("doPTP!inCS", self._guarded(cartesian=True)),
            ("doPTP!CSCircle1", self._guarded(cartesian=False)),
            ("startDirectServoJoints", lambda _: self._start_servo("servo")),
            ("stDcEEf_", lambda _: self._start_servo("cartesian_servo")),
            ("stVelDcJoint_", lambda _: self._start_servo("velocity_servo")),
            ("startSmartImpedneceJoints", self._start_impedance),
            ("Torques_ext_J", answer(lambda: f"{java_numbers.vector(arm.external_torques)}\n")),
            ("Torques_m_J", answer(lambda: f"{java_numbers.vector(arm.measured_torques)}\n")),
            ("Eef_pos", answer(self._tool_text)),
            ("Eef_force", answer(self._force_text)),
            ("Eef_moment", answer(lambda: f"{java_numbers.vector(np.zeros(3))}\n")),
            ("handGuiding", answer(lambda: DONE)),
            ("preciseHandGuiding1", answer(lambda: DONE)),
            ("preciseHandGuiding2", answer(lambda: DONE)),
        ]

    def _joints_text(self) -> str:
        return f"{java_numbers.vector(self._arm.q)}\n"

    def _tool_text(self) -> str:
        T = self._arm.tool
        return f"{java_numbers.vector([*(MM_PER_M * T[:3, 3]), *zyx_from_rotation(T[:3, :3])])}\n"

    def _force_text(self) -> str:
        return f"{java_numbers.vector(self._arm.tool_force)}\n"

    def _goal(self, take: Callable[[list[str]], bool], answer: Callable[[], str]) -> Callable[[list[str]], None]:
        def command(words: list[str]) -> None:
            reply = answer()
            if not take(words):
                self._reader_alive = False
                return
            if self._arm.in_servo:
                self._panel.goals += 1
            self._replies.append(reply)

        return command

    def _take_joints(self, words: list[str]) -> bool:
        try:
            goal = _overwritten(self._joint_goal, words)
        except ValueError:
            return False
        self._joint_goal = goal
        if self._arm.in_servo and self.mode in ("servo", "impedance_servo"):
            self._arm.goal = goal
        return True

    def _take_speeds(self, words: list[str]) -> bool:
        if len(words) > 7:
            return False
        try:
            self._speed_goal = _overwritten(self._speed_goal, words)
        except ValueError:
            self._stop_servo()
            return True
        if self._arm.in_servo and self.mode == "velocity_servo":
            self._arm.goal_speed = self._speed_goal
        return True

    def _take_pose(self, words: list[str]) -> bool:
        if len(words) > 6:
            return False
        try:
            self._poses["servo"] = _overwritten(self._poses["servo"], words)
        except ValueError:
            self._stop_servo()
            return True
        if self._arm.in_servo and self.mode == "cartesian_servo":
            try:
                goal = self._arm.robot.solve(self._pose("servo"), self._arm.T_flange_tool, self._arm.goal)
            except Unreachable:
                goal = None
            if goal is None:
                self._stop_servo()
            else:
                self._arm.goal = goal
        return True

    def _keep_pose(self, name: str) -> Callable[[list[str]], None]:
        def command(words: list[str]) -> None:
            try:
                self._poses[name] = _overwritten(self._poses[name], words)
            except ValueError:
                self._reader_alive = False
                return
            self._replies.append(DONE)

        return command

    def _stop(self, _: list[str]) -> None:
        self._stop_servo()
        self._replies.append(DONE)

    def _stop_servo(self) -> None:
        self._servo_starts = None
        self._arm.stop_servo()

    def _end(self, _: list[str]) -> None:
        self._stop_servo()
        self.ended = True

    def _output(self, name: str, on: bool) -> Callable[[list[str]], None]:
        def command(_: list[str]) -> None:
            self._panel.outputs[name] = on
            self._replies.append(DONE)

        return command

    def _attach(self, words: list[str]) -> None:
        if len(words) < 6:
            self._main_alive = False
        if len(words) != 6:
            raise ValueError
        numbers = _finite(words)
        self._arm.attach(pose(rotation_from_zyx(*numbers[3:]), numbers[:3] / MM_PER_M))
        self._replies.append(DONE)

    def _set_speed(self, words: list[str]) -> None:
        self._relative_speed = java_numbers.number(words[0])
        self._replies.append(DONE)

    def _move(self, make: Callable[[], object], torque_ranges: np.ndarray | None = None, final=lambda: DONE) -> None:
        self._replies.append(DONE)
        motion = make()
        if motion is None:
            self._replies.append(DONE)
            return
        break_when = None
        if torque_ranges is not None:
            joints, low, high = torque_ranges[:, 0].astype(int), torque_ranges[:, 1], torque_ranges[:, 2]

            def break_when(arm: Arm) -> bool:
                torque = arm.external_torques[joints]
                return bool(np.any((torque < low) | (torque > high)))

        self.mode = "ptp"
        self._final_word = final
        self._arm.start_motion(motion, break_when)

    def _joint_motion(self) -> JointMove | None:
        arm = self._arm
        if not 0.0 < self._relative_speed <= 1.0 or not arm.robot.within_range(self._joint_goal):
            raise Unreachable("the speed or the goal is out of range")
        if np.array_equal(arm.q, self._joint_goal):
            return None
        return JointMove(arm.q, self._joint_goal, self._relative_speed * arm.robot.max_speed, arm.motion_acceleration)

    def _line(self, target: np.ndarray):
        return self._follow(Line(self._arm.tool, target))

    def _circle(self):
        return self._follow(Circle(self._arm.tool, self._pose("Circ1"), self._pose("Circ2")))

    def _follow(self, path: Line | Circle):
        arm = self._arm
        speed = self._relative_speed / MM_PER_M
        return plan(path, speed, arm.robot, arm.T_flange_tool, arm.q, arm.motion_acceleration)

    def _relative(self, along_tool: bool) -> np.ndarray:
        return shifted(self._arm.tool, self._poses[""][:3] / MM_PER_M, along_tool)

    def _pose(self, name: str) -> np.ndarray:
        numbers = self._poses[name]
        if not np.all(np.isfinite(numbers)):
            raise Unreachable("the pose is not finite")
        return pose(rotation_from_zyx(*numbers[3:]), numbers[:3] / MM_PER_M)

    def _guarded(self, cartesian: bool) -> Callable[[list[str]], None]:
        def command(words: list[str]) -> None:
            ranges = _finite(words[: len(words) // 3 * 3]).reshape(-1, 3)
            if len(ranges) == 0:
                self._replies += [DONE, DONE]
                return
            if np.any((ranges[:, 0] < 0) | (ranges[:, 0] > 6)):
                self._replies.append(DONE)
                raise ValueError
            if cartesian:
                target = self._pose("")
                self._move(lambda: self._line(target), ranges, lambda: self._arrived_tool(target))
            else:
                target = self._joint_goal
                self._move(self._joint_motion, ranges, lambda: self._arrived_joints(target))

        return command

    def _arrived_joints(self, target: np.ndarray) -> str:
        return DONE if np.max(np.abs(self._arm.q - target)) <= ARRIVED_JOINT_RAD else INTERRUPTED

    def _arrived_tool(self, target: np.ndarray) -> str:
        return DONE if np.max(np.abs((self._arm.tool - target)[:3, 3])) <= ARRIVED_TOOL_M else INTERRUPTED

    def _start_servo(self, mode: str) -> None:
        self._replies.append(DONE)
        self.mode = mode
        self._servo_stopping = False
        self._servo_starts = self._now + SERVO_START_S

    def _start_impedance(self, words: list[str]) -> None:
        numbers = _finite(words)
        if len(numbers) < 7:
            raise ValueError
        mass, stiffness = numbers[0], numbers[4:7]
        refused = mass < 0.0 or np.any(stiffness < 0.0) or np.any(stiffness[:2] > MAX_STIFFNESS)
        if refused or np.max(np.abs(self._arm.external_torques)) > IMPEDANCE_MAX_TORQUE_NM:
            self._replies += [DONE, DONE]
        else:
            self._start_servo("impedance_servo")

    def _begin_servo(self) -> None:
        self._servo_starts = None
        arm = self._arm
        if self.mode == "servo":
            arm.start_servo()
            self._joint_goal = arm.goal
        elif self.mode == "cartesian_servo":
            arm.start_servo(law="none")
            T = arm.tool
            self._poses["servo"] = np.array([*(MM_PER_M * T[:3, 3]), *zyx_from_rotation(T[:3, :3])])
        elif self.mode == "velocity_servo":
            arm.start_servo(integrates=True)
            self._speed_goal = arm.goal_speed
        else:
            # The published server forgets joint 1 here: its goal stays what was sent last.
            arm.start_servo(law="none", share=IMPEDANCE_SHARE)
            self._joint_goal = np.array([self._joint_goal[0], *arm.q[1:]])
            arm.goal = self._joint_goal


def _overwritten(values: np.ndarray, words: list[str]) -> np.ndarray:
    """Returns the values with the first ones replaced by the numbers of the words; further words are ignored."""
    result = values.copy()
    for k, word in enumerate(words[: len(values)]):
        result[k] = java_numbers.number(word)
    return result


def _finite(words: list[str]) -> np.ndarray:
    numbers = np.array([java_numbers.number(word) for word in words])
    if not np.all(np.isfinite(numbers)):
        raise ValueError
    return numbers

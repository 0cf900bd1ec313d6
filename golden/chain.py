"""The rig without devices, ROS and clock: raw tracker frames in; desired tools, goals of the arm and of the hand out.

Time is handed in: a frame has the time of its receipt, and the controller a fixed cycle. The drives of the arm lag by a
constant; the robot hand is where it was sent.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import yaml

from common.config import parse
from common.poses import pose, read_only
from kuka_control.loop import assembly
from kuka_control.loop.arm import Arm, ArmState
from kuka_control.loop.commands import Inputs
from kuka_control.loop.controller import Controller
from kuka_control.loop.servo_law import lts
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.obstacles import ConvexBody
from kuka_control.model.rig import Rig
from kuka_control.model.robot_shape import Opening
from kuka_control.model.switches import Mode, SwitchState
from kuka_control.model.target import MotionScaling, check_tool_pose, scaled, seed
from leap_hand.config import HandConfig
from leap_hand.force_limit import FingerFeedback, ForceLimit
from leap_hand.teleop import GripperResult, HandTeleop
from leap_kuka.config import OPERATOR_INPUT, ArmPlacement, LeapConfig
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import TeleopResult
from leap_motion.codec import LeapProtocolError, read_message
from leap_motion.frames import LeapFrame, TrackingFrame, tracked_hands
from leap_motion.plausibility import HandBounds, PlausibleHands

SRC = Path(__file__).resolve().parents[1] / "src"
CYCLE_S = 0.004  # of the controller
CYCLES_PER_LOOK = 25  # after so many, what happens ten times a second: silence is noticed, the state is reported
CLOCK_S = 1.7e9  # ROS time less monotonic time
BEGIN_S = 100.0  # monotonic time at which a run begins
AFTERWARDS_S = 0.6  # a run ends so long after its last frame
SERVO_STEPS = 4  # of the robot's servo loop in a cycle
DRIVES_S = 0.04  # time constant of the arm's drives
SWITCHED_ON = ((0.0, "control", False), (0.1, "control", True), (0.1, "gripper", True))
SECTIONS = {"kuka": (RealTimeConfig, "kuka_control/config/kuka_params_rt.yaml"),
            "leap": (LeapConfig, "leap_kuka/config/leap_params.yaml"),
            "leap_hand": (HandConfig, "leap_hand/config/leap_hand.yaml")}  # fmt: skip


@dataclass(frozen=True)
class Run:
    """What goes into the rig.

    Attributes:
        name: of the recording.
        frames: time of receipt since the begin [s], and the text of the service, in the order of receipt.
        switched: the operator's switches: time [s], `control`, `gripper` or `input`, and the value.
        settings: parameters that differ from the shipped ones, by section (`kuka`, `leap`, `leap_hand`).
    """

    name: str
    frames: tuple[tuple[float, str], ...]
    switched: tuple[tuple[float, str, Any], ...] = SWITCHED_ON
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass
class Trace:
    """What comes out.

    Attributes:
        tools: desired tool in the base: position [m] and the first two columns of its rotation, shape (9,) a frame; NaN
            for a frame without one.
        hands: command of the robot hand, shape (4,) a frame [rad]; NaN where none is sent.
        goals: joints that the arm is sent, shape (7,) a cycle [rad]; NaN outside of servo mode.
        events: changes of the states, as text: time since the begin [s], who, what.
    """

    tools: list[np.ndarray] = field(default_factory=list)
    hands: list[np.ndarray] = field(default_factory=list)
    goals: list[np.ndarray] = field(default_factory=list)
    events: list[str] = field(default_factory=list)
    _said: dict[str, str] = field(default_factory=dict)

    def say(self, now: float, who: str, what: str) -> None:
        if self._said.get(who) != what:
            self._said[who] = what
            self.events.append(f"{now - BEGIN_S:.3f} {who}: {what}")


def parsed(section: str, changes: dict[str, Any], **more: Any) -> Any:
    """Returns the configuration of a section: as shipped, with changes."""
    schema, file = SECTIONS[section]
    values = yaml.safe_load((SRC / file).read_text())
    return parse(schema, {**values, **changes}, f"{section}/", **more)


class LaggingArm(Arm):
    """Follows goals with a lag, and goes along motions at the speed that they ask for; starts at the joints q [rad].

    Its controller has the servo law "lts" or "none". `sent` is the goal of this cycle, shape (7,) [rad], or None.
    """

    def __init__(self, q: np.ndarray, max_speed: np.ndarray, law: str) -> None:
        self._q, self._goal, self._max_speed = q.copy(), q.copy(), max_speed
        self._law = lts if law == "lts" else lambda error: error
        self._velocity: float | None = None  # of the motion
        self.sent: np.ndarray | None = None
        self.read()

    def tick(self) -> None:
        self.sent = None
        if self._velocity is None:
            for _ in range(SERVO_STEPS):
                self._q = self._q - math.expm1(-CYCLE_S / SERVO_STEPS / DRIVES_S) * self._law(self._goal - self._q)
            return
        way = self._goal - self._q
        time = float(np.max(np.abs(way) / self._max_speed)) / self._velocity
        self._q = self._goal.copy() if time <= CYCLE_S else self._q + CYCLE_S / time * way

    def read(self) -> None:
        self.state = ArmState(joints=read_only(self._q))

    def start_ptp(self, q: np.ndarray, velocity: float, torques: np.ndarray | None = None) -> None:
        self._goal, self._velocity = q.copy(), velocity

    def ptp_arrived(self) -> bool:
        if np.array_equal(self._q, self._goal):
            self._velocity = None
            return True
        return False

    def start_servo(self) -> None:
        self._goal = self._q.copy()
        self.read()

    def servo(self, q: np.ndarray) -> None:
        self._goal = self.sent = q.copy()
        self.read()

    def stop_servo(self) -> None:
        self.read()

    def close(self) -> None:
        """Has nothing to close."""


class World:
    """What stands around teleoperation and controller: configuration, arm, robot hand, operator, and the run's time."""

    def __init__(self, run: Run, obstacles: tuple[ConvexBody, ...] = ()) -> None:
        self.trace = Trace()
        settings = run.settings
        self.config: RealTimeConfig = parsed("kuka", settings.get("kuka", {}))
        self.rig = Rig.of(self.config, obstacles=obstacles)
        self.leap: LeapConfig = parsed("leap", settings.get("leap", {}), others=(OPERATOR_INPUT,))
        self.hand: HandConfig = parsed("leap_hand", settings.get("leap_hand", {}))
        values = {**vars(self.config), "ws_center": self.rig.home.centre}
        self.placement: ArmPlacement = parse(ArmPlacement, values, "kuka/", others=values)
        self.arm = LaggingArm(self.rig.home.q, self.rig.model.max_speed, self.config.servo_law)
        self.switches = SwitchState()
        self.mode = Mode.STARTING
        self.now = BEGIN_S
        self.fingers = np.zeros(4)
        self._guard = assembly.collision_guard(self.config, self.rig)
        self._opening: Opening | None = None
        self._frames, self._switched = list(reversed(run.frames)), list(reversed(run.switched))
        self._cycles = 0
        self._end = BEGIN_S + run.frames[-1][0] + AFTERWARDS_S

    def advance(self, chain: Chain) -> bool:
        """Brings time to the next cycle of the controller, and to the chain what came meanwhile; False: all came."""
        if self._cycles:
            self.trace.goals.append(np.full(7, np.nan) if self.arm.sent is None else self.arm.sent)
            self.arm.tick()
        self.now = BEGIN_S + self._cycles * CYCLE_S
        while self._switched and BEGIN_S + self._switched[-1][0] <= self.now:
            _, what, value = self._switched.pop()
            self.switch(chain, what, value)
        while self._frames and BEGIN_S + self._frames[-1][0] <= self.now:
            received, text = self._frames.pop()
            self._frame(chain, text, BEGIN_S + received)
        if self._cycles % CYCLES_PER_LOOK == 0:
            chain.look(self.now)
        self._cycles += 1
        return self.now < self._end

    def switch(self, chain: Chain, what: str, value: Any) -> None:
        """Sets what the operator switches."""
        if what == "control":
            count = self.switches.enable_count + (value and not self.switches.control_on)
            self.switches = replace(self.switches, control_on=value, enable_count=count)
        elif what == "scale":
            self.switches = replace(self.switches, scale=value)
        chain.switched(what, value, self.now)

    def _frame(self, chain: Chain, text: str, now: float) -> None:
        tool, command = chain.frame(text, now)
        self.trace.tools.append(
            np.full(9, np.nan) if tool is None else np.concatenate([tool[:3, 3], tool[:3, 0], tool[:3, 1]])
        )
        self.trace.hands.append(np.full(4, np.nan) if command is None else command)
        if command is not None:
            self.fingers = command

    @property
    def opening(self) -> Opening:
        """The joints of the robot hand; the same object until they have moved."""
        index, middle, thumb, spread = self.fingers.tolist()
        new = Opening((index, middle, thumb), (0.0, 0.0, 0.0), spread)
        if self._opening is None or new.differs(self._opening):
            self._opening = new
        return self._opening

    @property
    def feedback(self) -> FingerFeedback:
        return FingerFeedback(tuple(self.fingers[:3].tolist()), ((0.0,) * 9,) * 3, (0.0,) * 3)

    def measured_tool(self) -> np.ndarray:
        """Returns the pose of the arm's tool, shape (4, 4) [m]."""
        return self.rig.kinematics.forward(self.arm.measured_joints)

    def can_reach(self, T_base_desired: np.ndarray, starts: bool) -> str | None:
        """Returns why the arm cannot come to a desired tool frame, shape (4, 4) [m], as the controller answers it."""
        scale, centre = self.switches.scale, self.rig.home.centre
        T = pose(T_base_desired[:3, :3], scaled(T_base_desired[:3, 3], centre, scale))
        q = seed(self.mode, self.arm.measured_joints, self.rig.home.q)
        return check_tool_pose(
            self.rig.chain, T, MotionScaling(scale), q, self.mode is Mode.SERVO, self._meets
        ).obstacle

    def _meets(self, q: np.ndarray) -> str | None:
        return None if self._guard is None else self._guard.fault_at(q)


class Chain(Protocol):
    """Teleoperation and controller, to which the world brings what comes, in the order of time `now` [s]."""

    def switched(self, what: str, value: Any, now: float) -> None:
        """Takes what the operator switched."""

    def frame(self, text: str, now: float) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Takes a text of the tracker; returns the desired tool in the base, shape (4, 4) [m], and the command of the
        robot hand, shape (4,) [rad].
        """

    def look(self, now: float) -> None:
        """Does what is done ten times a second."""


class PureChain:
    """The pure objects that the nodes are made of, connected directly."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._arm = ArmTeleop(world.leap, world.placement, world.can_reach, world.measured_tool)
        self._hand, self._force_limit = HandTeleop(world.hand, False, world.leap.hand), ForceLimit(world.hand)
        self._loop = assembly.real_time_loop(world.config, world.rig)
        self._controller = Controller(world.arm, self._loop)
        self._newest: DesiredFrame | None = None
        self._engagements, self._without_hand = 0, False  # as DesiredTool counts them
        self._last: tuple[int, int] | None = None
        self._plausible = PlausibleHands(HandBounds())

    def run(self) -> Trace:
        while self._world.advance(self):
            self.cycle()
        return self._world.trace

    def cycle(self) -> None:
        world, trace = self._world, self._world.trace
        self._loop.open_hand(world.opening)
        step = self._controller.cycle(Inputs(self._newest, CLOCK_S + world.now, world.switches), world.now)
        if step.mode is not world.mode:
            world.mode = step.mode
            self._status(world.now)
        trace.say(world.now, "kuka", f"{step.mode.value}, limited by {' and '.join(step.limited_by) or 'nothing'}")
        for event in step.events:
            trace.say(world.now, "kuka says", without_numbers(event.sentence))

    def switched(self, what: str, value: Any, now: float) -> None:
        if what == "gripper":
            self._carry_out(self._hand.switch(value), now)
        elif what == "input":
            enabled, clutch = value
            self._arm.switches.device.take(enabled, clutch, "service", 0.0, now, "operator")
        else:
            self._status(now)

    def frame(self, text: str, now: float) -> tuple[np.ndarray | None, np.ndarray | None]:
        say = self._world.trace.say
        try:
            frame = read_message(text)
        except LeapProtocolError as error:
            say(now, "codec", without_numbers(str(error)))
            return None, None
        if not isinstance(frame, LeapFrame) or (frame.id, frame.timestamp_us) == self._last:
            return None, None
        self._last = frame.id, frame.timestamp_us
        frame = self._plausible.step(frame, now)
        say(now, "codec", f"left out: {without_numbers(str(frame.left_out))}" if frame.left_out else "fine")
        tracking = TrackingFrame(frame.id, 0.0, tracked_hands(frame))
        result = self._arm.step(tracking, now)
        self._tell(result, now)
        tool = None
        if result.usable and result.T_virtual_tool is None:
            self._without_hand = self._newest is not None
        elif result.usable:
            if result.T_virtual_filtered is not None:
                self._engagements += self._without_hand
                self._without_hand = False
            tool = result.T_base_virtual @ result.T_virtual_tool
            self._newest = DesiredFrame(tool, CLOCK_S + now, engagement=self._engagements)
        return tool, self._carry_out(self._hand.step(tracking, now), now)

    def look(self, now: float) -> None:
        self.feel(now)
        self._status(now)
        self._tell(self._arm.silence(now), now)
        self._carry_out(self._hand.silence(now), now)

    def feel(self, now: float) -> None:
        self._force_limit.update(self._world.feedback, now)

    def _status(self, now: float) -> None:
        switches = self._world.switches
        self._arm.control(switches.control_on, self._world.mode.value, switches.scale, now)

    def _tell(self, result: TeleopResult | None, now: float) -> None:
        if result is not None:
            self._hand.steered_by(result.owner, now, result.keep_grip)
            self._world.trace.say(now, "leap_kuka", f"{result.state.value}: {without_numbers(result.reason)}")

    def _carry_out(self, result: GripperResult | None, now: float) -> np.ndarray | None:
        if result is None:
            return None
        self._world.trace.say(now, "leap_hand", f"{result.state.value}: {without_numbers(result.reason)}")
        return None if result.command is None else self._force_limit.clip(result.command, now).command


def without_numbers(text: str) -> str:
    """Returns a sentence in which # stands for each number with a decimal point or unit: its last digit may differ."""
    return re.sub(r"-?\d+(\.\d+)?", "#", text)

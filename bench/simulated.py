"""The control loop and the simulated arm without wire and clock: the same on every machine."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import yaml

from bench.measure import SRC
from common.config import parse
from common.poses import read_only
from kuka_control.loop import assembly
from kuka_control.loop.arm import Arm, ArmState
from kuka_control.loop.commands import End, Inputs, Servo
from kuka_control.loop.controller import Controller
from kuka_control.model.config import DhDeviations, RealTimeConfig
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.rig import Rig
from kuka_control.model.switches import SwitchState
from rig_simulation.devices.sunrise.arm import ArmSettings
from rig_simulation.devices.sunrise.arm import SimulatedArm as Joints
from rig_simulation.devices.sunrise.robot import CYCLE_S, Robot
from rig_simulation.files import read_urdf

CLOCK_S = 1.7e9
CYCLES_PER_GOAL = 4
"""Of the simulated arm."""


class SimulatedArm(Arm):
    """The simulated controller's arm, with readings as often as on the wire: joints with six of ten goals."""

    def __init__(self, joints: Joints) -> None:
        self.joints = joints
        self.sent = joints.q
        self._calls = 0
        self.read()

    def read(self) -> None:
        """Reads the joints."""
        self.state = ArmState(joints=read_only(self.joints.q))

    def start_ptp(self, q: np.ndarray, velocity: float, torques: np.ndarray | None = None) -> None:
        """Jumps there."""
        self.joints.q = np.array(q)
        self.read()

    def ptp_arrived(self) -> bool:
        """Returns True."""
        return True

    def start_servo(self) -> None:
        """Follows goals from now on."""
        self.joints.start_servo()
        self.read()

    def servo(self, q: np.ndarray) -> None:
        """Takes a goal; reads the joints before it acts."""
        self._calls += 1
        if self._calls % 10 in (0, 1, 3, 5, 7, 9):
            self.read()
        self.sent = self.joints.goal = q

    def stop_servo(self) -> None:
        """Follows no goals any longer."""
        self.joints.stop_servo()

    def close(self) -> None:
        """Has nothing to close."""


class SimulatedRig:
    """A controller on a simulated arm, and a hand.

    Args:
        server_law: of the simulated controller.
        robot: the simulated arm; that of the rig's description where left out.
        dh: how the controller takes its arm to be off the data sheet.
        changes: of parameters.

    Attributes:
        goals: what the limiter made, one row per goal, shape (n, 7) [rad]; sent: what went to the arm.
        q, v: joints of the arm at those times, shape (n, 7).
        times: of the goals [s]."""

    def __init__(
        self, server_law: str = "lts", robot: Robot | None = None, dh: DhDeviations | None = None, **changes
    ) -> None:
        values = yaml.safe_load((SRC / "kuka_control/config/kuka_params_rt.yaml").read_text())
        self.config = parse(RealTimeConfig, {**values, "collision_guard": False, **changes}, "kuka/")
        self.rig = Rig.of(self.config, dh)
        robot = robot or Robot(read_urdf(self.config.robot, self.config.flange))
        self.joints = Joints(robot, ArmSettings(servo_law=server_law))
        self.joints.attach(self.rig.T_flange_tool)
        self.arm = SimulatedArm(self.joints)
        self.loop = assembly.real_time_loop(self.config, self.rig)
        self.controller = Controller(self.arm, self.loop)
        self.now = 100.0
        self.newest: DesiredFrame | None = None
        self._hands = 0
        self.step = None
        self.events: list[str] = []
        self._clear()

    def at_home(self) -> SimulatedRig:
        """Runs until the arm is at home."""
        while self.step is None or self.step.mode != "home":
            self._cycle(control_on=False)
            if isinstance(self.step.command, End) or self.now > 110.0:
                break
        return self

    def follow(
        self,
        seconds: float,
        tool: Callable[[float], np.ndarray],
        rate: float = 74.0,
        jitter: Callable[[], float] | None = None,
        frames_for: float = math.inf,
    ) -> SimulatedRig:
        """Follows a tool frame, shape (4, 4) [m], that is a function of time [s], in frames at `rate` [Hz]. `jitter`
        returns how late each frame comes [s]; no frames come after `frames_for` [s]."""
        if self.newest is None:
            for control_on in [False] * 100 + [True]:  # a stream counts only if it begins while control is on
                self._cycle(control_on)
        self._hands += 1  # another one each time
        self._clear()
        frames = []
        for i in range(int(min(seconds, frames_for) * rate) + 1):
            frames.append((i / rate + (jitter() if jitter else 0.0), i / rate))
        while self.now - self.start < seconds:
            while frames and frames[0][0] <= self.now - self.start + 1e-9:
                stamp = frames.pop(0)[1]
                self.newest = DesiredFrame(tool(stamp), CLOCK_S + self.start + stamp, engagement=self._hands)
            self._cycle(control_on=True)
        self.times, self.goals, self.sent, self.q, self.v = (
            np.array(column) for column in (self.times, self.goals, self.sent, self.q, self.v)
        )
        return self

    def _cycle(self, control_on: bool) -> None:
        inputs = Inputs(self.newest, CLOCK_S + self.now, SwitchState(control_on, int(control_on)))
        self.step = self.controller.cycle(inputs, self.now)
        self.events += [event.sentence for event in self.step.events]
        if isinstance(self.step.command, Servo) and self.step.mode == "servo":
            self.times.append(self.now - self.start)
            self.goals.append(self.loop.goal)
            self.sent.append(self.arm.sent)
            self.q.append(self.joints.q)
            self.v.append(self.joints.v)
        for _ in range(CYCLES_PER_GOAL):
            self.joints.step(CYCLE_S)
        if not self.controller.in_servo:
            self.arm.read()
        self.now += CYCLES_PER_GOAL * CYCLE_S

    def _clear(self) -> None:
        self.start = self.now
        self.times, self.goals, self.sent, self.q, self.v = [], [], [], [], []

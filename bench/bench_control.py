"""The arm's controller without its wire: target chain, motion limits, and whole cycles on an arm that costs nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import yaml

from bench.measure import SRC, Goal, Row, row, timed
from common.config import parse
from common.poses import pose, read_only
from kuka_control.limits.motion_limits import MotionLimits
from kuka_control.loop import assembly
from kuka_control.loop.arm import Arm, ArmState
from kuka_control.loop.commands import Inputs, Servo
from kuka_control.loop.controller import Controller
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.obstacles import ConvexBody, ConvexShape
from kuka_control.model.rig import Rig
from kuka_control.model.switches import SwitchState
from kuka_control.model.target import MotionScaling

CLOCK_S = 1.7e9
GOAL_S = 1.0 / 250.0
GOALS_PER_FRAME = 2
FRAME_S = GOALS_PER_FRAME * GOAL_S
AT_HOME_S = 0.5
RADIUS_M = 0.06
SPEED_M_S = 0.15
GOAL_US = Goal(150.0)
GUARD_US = Goal(300.0)


class IdealArm(Arm):
    """Is at once where it is sent."""

    def __init__(self, q: np.ndarray) -> None:
        self._be_at(q)

    def read(self) -> None:
        """Has nothing new to read."""

    def start_ptp(self, q: np.ndarray, velocity: float, torques: np.ndarray | None = None) -> None:
        """Jumps there."""
        self._be_at(q)

    def ptp_arrived(self) -> bool:
        """Returns True."""
        return True

    def start_servo(self) -> None:
        """Is ready."""

    def servo(self, q: np.ndarray) -> None:
        """Jumps there."""
        self._be_at(q)

    def stop_servo(self) -> None:
        """Stands already."""

    def close(self) -> None:
        """Has nothing to close."""

    def _be_at(self, q: np.ndarray) -> None:
        self.state = ArmState(joints=read_only(q))


def rows(quick: bool) -> list[Row]:
    """Returns the time of the steps and of the whole cycle for a tool that runs in circles about the centre."""
    count = 200 if quick else 10_000
    config = parse(
        RealTimeConfig, yaml.safe_load((SRC / "kuka_control/config/kuka_params_rt.yaml").read_text()), "kuka/"
    )
    rig = Rig.of(config)
    home = rig.kinematics.forward(rig.home.q)
    circle = [_on_circle(home, i * FRAME_S) for i in range(count)]

    near = [rig.home.q]

    def resolve(T: np.ndarray):
        target = rig.chain.resolve(T, MotionScaling(), near[0])
        near[0] = target.q
        return target

    settings = f"circle of {1e3 * RADIUS_M:.0f} mm at {SPEED_M_S:g} m/s"
    times, targets = timed(resolve, [(T,) for T in circle])
    table = [row("control: target chain", times, "us", f"scaling, workspace, IK; {settings}")]

    times = _steps(assembly.motion_limits(config, rig), rig, targets)
    table.append(row("control: motion limits", times, "us", settings))
    return table + _guard(config, rig, targets, settings) + _cycles(config, rig, circle, settings)


def _guard(config: RealTimeConfig, rig: Rig, targets: list, settings: str) -> list[Row]:
    """Returns what the collision guard adds to a step of the motion limits, without and with a wall in the way."""
    x, y, z = rig.home.centre
    middle = (x, y + 0.21, z)
    wall = ConvexBody("wall", 0, ConvexShape("box", (0.3, 0.02, 0.3)), read_only(pose(p=middle)))
    table = []
    for name, around in (("free", ()), ("at a wall", (wall,))):
        taken = []
        for guard in (None, assembly.collision_guard(config, replace(rig, obstacles=around))):
            taken.append(_steps(assembly.motion_limits(config, rig, guard), rig, targets))
        table.append(row(f"control: collision guard, {name}", taken[1] - taken[0], "us", settings, GUARD_US))
    return table


def _steps(limits: MotionLimits, rig: Rig, targets: list) -> np.ndarray:
    """Returns the time of each step towards the targets [s]."""
    limits.reset(rig.home.q)
    return timed(lambda q: limits.step(q, limits.goal, FRAME_S), [(target.q,) for target in targets])[0]


def _cycles(config: RealTimeConfig, rig: Rig, circle: list[np.ndarray], settings: str) -> list[Row]:
    controller = Controller(IdealArm(rig.home.q), assembly.real_time_loop(config, rig))
    inputs = []
    for i in range(GOALS_PER_FRAME * len(circle)):
        now = 100.0 + i * GOAL_S
        frame = i // GOALS_PER_FRAME
        # The hand comes in when the arm is at home and control is on.
        desired = DesiredFrame(circle[frame], CLOCK_S + 100.0 + frame * FRAME_S) if i * GOAL_S > AT_HOME_S else None
        inputs.append((Inputs(desired, CLOCK_S + now, SwitchState(control_on=True, enable_count=1)), now))
    times, steps = timed(controller.cycle, inputs)
    servo = np.array([isinstance(step.command, Servo) for step in steps])
    fresh = np.array([isinstance(step.command, Servo) and step.command.stamp is not None for step in steps])
    return [
        row("control: cycle, new desired tool", times[fresh], "us", f"arm without wire; {settings}", GOAL_US),
        row("control: cycle in between", times[servo & ~fresh], "us", f"arm without wire; {settings}"),
    ]


def _on_circle(home: np.ndarray, t: float) -> np.ndarray:
    """Returns the tool frame, shape (4, 4) [m], that starts at home with the time t [s]."""
    angle = SPEED_M_S / RADIUS_M * t
    shift = RADIUS_M * np.array([0.0, np.sin(angle), 1.0 - np.cos(angle)])
    return pose(home[:3, :3], home[:3, 3] + shift)

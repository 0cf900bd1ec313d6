"""Two arms with their robot hands in one physical world, each behind the pure chain of its side, without ROS and time.

The operator's hands are those of the guided Leap service: what they do is asked for while the world runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import yaml

from common.arms import Arms, arms_from
from golden.chain import BEGIN_S, CYCLE_S, SRC, SWITCHED_ON, PureChain, Run, World
from kuka_control.loop.arm import Arm, ArmState
from kuka_control.model.arms import walls
from kuka_control.model.obstacles import ConvexBody
from kuka_control.model.robot_shape import Opening
from leap_hand.force_limit import FingerFeedback
from rig_simulation.devices.reflex.wire import POSITION, ModeCommand, TargetCommand
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.paths import JointMove
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.files import read_scene, read_urdf
from rig_simulation.operator.guided import GuidedOperator
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import BothHands, Playback, ScriptedOperator
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.parts import ArmJoints, CarriedJoints, HandPart
from rig_simulation.world.physics import World as Physics

SIDES = ("left", "right")
KIND = ("LBR7R800", "MF_elektrisch")
CONFIG = SRC / "kuka_control/config"
STEP_S = 0.001  # of the physics
FRAME_RATE_HZ = 60.0
HEIGHT_MM = 350.0  # of the hands' entry
CLOSING = (1, -1, 1)  # sign of a motor's effort, by finger
TICKS = 1024 / (2 * np.pi)  # of a motor in a radian
DIRECTION = np.array([1, -1, 1, -1])  # in which the ticks of a motor count while its spool winds up
RATIOS = np.array([1.42, 1.42, 1.42, 1.5])  # turns of a motor in one of its spool
FEEL_CYCLES = 6  # of the controller, between two states of the robot hand


class PhysicalArm(Arm):
    """A simulated arm behind the interface of the controller; `step` is called four times in a cycle."""

    def __init__(self, arm: SimulatedArm, step: Callable[[float], None] | None) -> None:
        self._arm, self._step = arm, step
        self.sent: np.ndarray | None = None
        self.read()

    def tick(self) -> None:
        self.sent = None
        if self._step is not None:
            for _ in range(round(CYCLE_S / STEP_S)):
                self._step(STEP_S)

    def read(self) -> None:
        self.state = ArmState(joints=self._arm.q)

    def start_ptp(self, q: np.ndarray, velocity: float, torques: np.ndarray | None = None) -> None:
        arm = self._arm
        arm.start_motion(JointMove(arm.q, q, velocity * arm.robot.max_speed, arm.motion_acceleration))

    def ptp_arrived(self) -> bool:
        return not self._arm.in_motion

    def start_servo(self) -> None:
        self._arm.start_servo()
        self.read()

    def servo(self, q: np.ndarray) -> None:
        self._arm.goal = self.sent = q.copy()
        self.read()

    def stop_servo(self) -> None:
        self._arm.stop_servo()
        self.read()

    def close(self) -> None:
        """Has nothing to close."""


class Side(World):
    """What stands around the chain of one side: its arm and its robot hand in the physical world."""

    def __init__(self, run: Run, arm: PhysicalArm, hand: HandPart, obstacles: tuple[ConvexBody, ...]) -> None:
        super().__init__(run, obstacles)
        self.arm, self.robot_hand = arm, hand.simulated
        self.robot_hand.handle(ModeCommand((POSITION,) * 4))

    def grip(self, command: np.ndarray) -> None:
        """Sends the fingers to a command, shape (4,) [rad]."""
        state = self.robot_hand.state()
        ticks = np.array(state["positions"]) + DIRECTION * RATIOS * TICKS * (command - state["angles"])
        self.robot_hand.handle(TargetCommand(tuple(round(tick) for tick in ticks.tolist())))

    @property
    def opening(self) -> Opening:
        state = self.robot_hand.state()
        return Opening(tuple(state["proximal"]), tuple(state["distal"]), state["angles"][3])

    @property
    def feedback(self) -> FingerFeedback:
        state = self.robot_hand.state()
        loads = tuple(sign * effort for sign, effort in zip(CLOSING, state["efforts"]))
        return FingerFeedback(tuple(state["angles"][:3]), tuple(map(tuple, state["touch"])), loads)


class TwoArms:
    """The whole; `settings` as of a Run, for each side; `apart`: of the hands where they come in [m]; `seed`: of what
    differs from hand to hand.

    Attributes:
        arms: where the bases stand.
        physics: the world.
        operators: the operator's hands, by side.
        sides: of each chain.
        now: time since the begin [s].
    """

    def __init__(
        self, scene: str | Mapping[str, Any], apart: float, settings: Mapping[str, Any] | None = None, seed: int = 0
    ) -> None:
        two = yaml.safe_load((CONFIG / "two_arms.yaml").read_text())
        ahead = yaml.safe_load((CONFIG / "arm_of_two.yaml").read_text())
        self.arms: Arms = arms_from(two)
        self.physics = Physics(WorldDescription(*KIND, (0.0,) * 3, _scene(scene), None, two))
        hands = {side: HandPart(seed + number, side) for number, side in enumerate(SIDES)}
        for hand in hands.values():
            self.physics.add(hand)
        driver, carried = ArmJoints(self.physics, True, SIDES[0]), CarriedJoints(self.physics, SIDES[1])
        robot, law = Robot(read_urdf(*KIND)), ArmSettings(servo_law="none")
        self.robots = {SIDES[0]: SimulatedArm(robot, law, driver), SIDES[1]: SimulatedArm(robot, law, carried)}
        driver.carry(carried, self.robots[SIDES[1]].step)
        script = Script()
        scripted = [
            ScriptedOperator(script, side, centre=(x, HEIGHT_MM, 0.0), frame_rate=FRAME_RATE_HZ)
            for side, x in zip(SIDES, (-500.0 * apart, 500.0 * apart))
        ]
        self.operators = {side: GuidedOperator(hand) for side, hand in zip(SIDES, scripted)}
        self._playback = Playback(BothHands(tuple(self.operators.values()), frame_rate=FRAME_RATE_HZ), seed)
        self._next = self._playback.next()
        self.now = 0.0
        self.sides: dict[str, Side] = {}
        self.chains: dict[str, PureChain] = {}
        for side, x in zip(SIDES, (-apart / 2.0, apart / 2.0)):
            own = {"kuka": {**ahead, "servo_law": "none"}, "leap": {"hand": side, "box_offset": x}}
            for section, values in (settings or {}).items():
                own.setdefault(section, {}).update(values)
            arm = PhysicalArm(self.robots[side], self.robots[side].step if side == SIDES[0] else None)
            run = Run(side, ((1e9, ""),), switched=(), settings=own)
            self.sides[side] = Side(run, arm, hands[side], walls(self.arms, side))
            self.robots[side].T_flange_tool = self.sides[side].rig.T_flange_tool
            self.chains[side] = PureChain(self.sides[side])
        self._cycles = 0

    def step(self) -> None:
        texts = []
        while self._next.time <= self.now:
            texts.append(self._next.text)
            self._next = self._playback.next()
        for name, side in self.sides.items():
            chain = self.chains[name]
            side.advance(chain)
            for text in texts:
                _, command = chain.frame(text, BEGIN_S + self.now)
                if command is not None:
                    side.grip(command)
            if self._cycles % FEEL_CYCLES == 0:
                chain.feel(BEGIN_S + self.now)
            chain.cycle()
        self._cycles += 1
        self.now += CYCLE_S

    def switch_on(self) -> None:
        for name, side in self.sides.items():
            for _, what, value in SWITCHED_ON:
                side.switch(self.chains[name], what, value)

    def T_world_flange(self, side: str) -> np.ndarray:
        """Returns the pose of a flange, shape (4, 4) [m]."""
        arm = self.robots[side]
        return self.arms.placements[side].T_world_base @ arm.robot.flange(arm.q)

    def T_world_tool(self, side: str) -> np.ndarray:
        """Returns the pose of a tool, shape (4, 4) [m]."""
        return self.arms.placements[side].T_world_base @ self.robots[side].tool

    def following(self, side: str) -> bool:
        return self.sides[side].mode.value == "servo"


def _scene(scene: str | Mapping[str, Any]) -> Mapping[str, Any]:
    return read_scene(scene) if isinstance(scene, str) else scene

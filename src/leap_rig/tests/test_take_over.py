"""A hand takes the arm over where the tool is held for it: teleoperation and control loop composed, without ROS."""

from __future__ import annotations

import gzip
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from common.config import parse
from common.poses import read_only
from common.rotations import rotation_about, rotation_angle, rotation_from_zyx
from kuka_control.loop import assembly
from kuka_control.loop.arm import Arm, ArmState
from kuka_control.loop.commands import Inputs
from kuka_control.loop.controller import Controller
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.rig import Rig as KukaRig
from kuka_control.model.switches import SwitchState
from kuka_control.model.target import MotionScaling
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.teleop import ArmTeleop
from leap_kuka.tool_hold import HoldState
from leap_kuka.virtual_leap import R_LEAP_REFERENCE
from leap_motion.frames import TrackedHand, TrackingFrame

SRC = Path(__file__).parents[2]
DT = 0.004
FRAME_CYCLES = 2
CLOCK = 1.7e9
BOX = np.array([0.0, 0.35, 0.0])


def parameters(path):
    return yaml.safe_load((SRC / path).read_text())


class StillArm(Arm):
    """Is where it was told to be."""

    def __init__(self):
        self.goals = []
        self._tell(np.full(7, 0.1))

    def read(self):
        pass

    def start_ptp(self, q, velocity, torques=None):
        self._tell(q)

    def ptp_arrived(self):
        return True

    def start_servo(self):
        self.goals = []

    def servo(self, q):
        self.goals.append(q)
        self._tell(q)

    def stop_servo(self):
        pass

    def close(self):
        pass

    def _tell(self, q):
        self.state = ArmState(read_only(q))


class Rig:
    """The chain from hands to joints; frames of the Leap come in every second cycle of the control loop."""

    def __init__(self):
        values = parameters("kuka_control/config/kuka_params_rt.yaml")
        config = parse(RealTimeConfig, values, "kuka/")
        self.rig = KukaRig.of(config)
        arm = {**values, "ws_center": self.rig.home.centre.tolist()}
        known = {key: arm[key] for key in ("center_line", "z_lower_limit", "tool_length", "ws_center")}
        leap = parse(LeapConfig, parameters("leap_kuka/config/leap_params.yaml"), "leap/")
        self.teleop = ArmTeleop(leap, parse(ArmPlacement, known, "kuka/"))
        self.teleop.control(False)
        self.arm = StillArm()
        self.controller = Controller(self.arm, assembly.real_time_loop(config, self.rig))
        self.scale = 1.0
        self.control_on = False
        self.now = 100.0
        self.cycles = 0
        self.desired = self.result = None
        self.modes, self.tools = [], []

    def run(self, seconds, *hands):
        return self.play([hands] * round(seconds / (DT * FRAME_CYCLES)))

    def play(self, frames):
        for hands in frames:
            self.result = self.teleop.step(TrackingFrame(self.cycles, 0.0, hands), self.now)
            if self.result.T_virtual_tool is not None:
                T = self.result.T_base_virtual @ self.result.T_virtual_tool
                self.desired = DesiredFrame(T, CLOCK + self.now)
            for _ in range(FRAME_CYCLES):
                inputs = Inputs(
                    self.desired, CLOCK + self.now, SwitchState(self.control_on, int(self.control_on), scale=self.scale)
                )
                step = self.controller.cycle(inputs, self.now)
                if self.modes[-1:] != [step.mode]:
                    self.modes.append(step.mode)
                self.tools.append(self.rig.kinematics.forward(self.arm.state.joints))
                self.now += DT
                self.cycles += 1
        return self

    def hold(self, T_base_tool, seconds=60.0):
        """The tool waits above a thing on the table."""
        while "home" not in self.modes:
            assert self.now < 103.0, self.modes
            self.run(0.1)
        self.run(0.5)  # without a desired tool: a stream counts only if it begins while control is on
        self.control_on = True
        self.teleop.control(True)
        self.modes.clear()
        T_base_desired = self.rig.chain.desired(T_base_tool, MotionScaling(self.scale))
        assert self.teleop.hold(T_base_desired, seconds, self.now).success
        for x in (0.3, 0.3, 0.3, None):  # the hand comes in while control is on
            self.run(DT * FRAME_CYCLES, *([] if x is None else [hand(0.0, 0.0, 0.0, (x, 0.0, 0.0))]))
        return self.run(1.0)

    def tool(self, x, y, z, turn):
        """The home tool, shifted [m] and turned about the vertical [deg]."""
        T = self.rig.home.T_base_tool.copy()
        T[:3, 3] += (x, y, z)
        T[:3, :3] = T[:3, :3] @ rotation_about(2, np.radians(turn))
        return T


def hand(yaw, pitch, roll, at=(0.0, 0.0, 0.0)):
    R = R_LEAP_REFERENCE @ rotation_from_zyx(*np.radians([yaw, pitch, roll]))
    return TrackedHand(7, False, BOX + at, R[:, 0], R[:, 2], 1.0)


def moved(a, b):
    return np.linalg.norm(a[:3, 3] - b[:3, 3]), rotation_angle(a[:3, :3].T @ b[:3, :3])


@pytest.mark.parametrize(("scale", "turn", "angles"), [
    (1.0, 0.0, (0.0, 0.0, 0.0)), (1.0, 70.0, (40.0, 18.0, -18.0)), (0.5, -60.0, (40.0, 18.0, -18.0)),
    (0.5, 70.0, (0.0, 0.0, 0.0)),
])  # fmt: skip
def test_the_hand_takes_over_without_a_jump_and_without_a_return_home(scale, turn, angles):
    rig = Rig()
    rig.scale = scale
    T = rig.tool(0.03, 0.02, -0.08, turn)
    rig.hold(T)
    assert [mode for mode in rig.modes if mode != "home"] == ["pick_up", "servo"]
    np.testing.assert_allclose(rig.tools[-1], T, atol=1e-6)
    first = len(rig.tools)
    rig.run(2.0, hand(*angles, at=(0.05, -0.04, 0.03)))
    assert rig.result.hold == HoldState.TAKEN and rig.modes[-1] == "servo" and rig.modes.count("servo") == 1
    for before, after in zip(rig.tools[first:], rig.tools[first + 1 :]):
        distance, angle = moved(before, after)
        assert distance < 5e-4 and angle < np.radians(0.5)
    assert moved(rig.tools[-1], T)[0] < 1e-4
    rig.play([(hand(*angles, at=(0.05, -0.04 - 0.03 * i / 100.0, 0.03)),) for i in range(100)])
    rig.run(0.5, hand(*angles, at=(0.05, -0.07, 0.03)))
    assert rig.tools[-1][2, 3] - T[2, 3] == pytest.approx(-0.03 * scale, abs=1e-3)
    assert rig.modes.count("servo") == 1
    rig.run(0.8)
    assert rig.modes[-3:] == ["servo", "returning", "home"]


@pytest.mark.parametrize(
    "name, lift", [("confidence-74fps", (0.0, 0.19, 0.0)), ("rollAndPitchWithEntry", (-0.05, 0.19, 0.0))]
)
def test_a_recorded_hand_takes_over_without_a_jump(shared_data, name, lift):
    rig = Rig()
    T = rig.tool(0.0, 0.0, -0.05, 45.0)
    rig.hold(T)
    with gzip.open(shared_data / "leap" / f"{name}.jsonl.gz", "rt") as file:
        frames = [
            tuple(
                TrackedHand(
                    h["id"],
                    h["type"] == "left",
                    np.array(h["palmPosition"]) / 1e3 + lift,
                    h["direction"],
                    h["palmNormal"],
                    h["confidence"],
                )
                for h in json.loads(line)["hands"]
            )
            for line in file
        ]
    first = next(hands for hands in frames if hands)  # the recording begins with hands in the box: they come in before
    rig.play([tuple(replace(h, palm=np.add(h.palm, (0.4, 0.0, 0.0))) for h in first)] * 3 + [()])
    frames = iter(frames)
    while rig.result.hold == HoldState.HELD:
        rig.play([next(frames)])
    assert rig.result.hold == HoldState.TAKEN
    distance, angle = moved(rig.tools[-1], T)
    assert distance < 5e-4 and angle < np.radians(0.5)
    rig.play(itertools.islice(frames, 60))
    assert rig.modes[-1] == "servo" and rig.modes.count("servo") == 1

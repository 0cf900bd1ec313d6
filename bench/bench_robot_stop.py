"""How the robot application itself ends what moves at 0.5 m/s: by a stop, and by its watchdog. Simulated time: the same
on every machine. A soft arm turns stiff at a stop, and stays soft while the watchdog holds it."""

from __future__ import annotations

import math

import numpy as np

from bench.measure import Goal, Row, number
from rig_simulation.devices.sunrise.application import ControllerIO
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.leap_rig import LeapRigApplication
from rig_simulation.devices.sunrise.robot import CYCLE_S, Robot
from rig_simulation.files import read_urdf

SPEED_M_S, RESTING_M_S = 0.5, 0.005
REST, WAY, BEGINS = Goal(150.0), Goal(60.0), Goal(20.0)
START = np.array([0.0, 1.2, 0.0, -0.4, 0.0, 0.0, 0.0])
TURN = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # of the goals, in proportion
SERVO_RAD_S, GOAL_S, LONGEST_S = 0.42, 0.01, 3.0
SILENCE_S = 0.05  # after longer ones the arm stands at its last goal already
TOOL_M = 0.2  # of the tool point from the flange
STIFFNESS = {
    "soft joints": "lrSoftJoints_1000_1000_1000_1000_500_300_200_0.7_",
    "soft tool": "lrSoftTool_2000_2000_2000_200_200_200_0.7_50_200_50_500_2_",
}
MOTIONS = {
    "PTP": "doPTPinJS",
    "guarded PTP": "doPTP!inJS_0_-300_300_",
    "servo": "startDirectServoJoints",
    "soft joints": "startDirectServoJoints",
    "soft tool": "startDirectServoJoints",
    "float": "lrFloat_",
    "hand guiding": "lrGuide_",
}


class Moving:
    """An arm that moves at the wanted speed, and its client, which is alive until then."""

    def __init__(self, motion: str) -> None:
        robot = Robot(read_urdf("LBR7R800", "MF_elektrisch"))
        self.arm = SimulatedArm(robot, ArmSettings(math.inf, math.inf))
        self.arm.q, self.arm.enabling = START, True
        self.application, self.now = LeapRigApplication(self.arm, ControllerIO()), 0.0
        start = MOTIONS[motion]
        centre = "_".join(str(1e3 * x) for x in self.arm.hand.com)
        tool = f"lrTool_{self.arm.hand.mass}_{centre}_0_0_{1e3 * TOOL_M}_0_0_0_"
        for line in (
            "lrHello_1_",
            f"lrWatchdog_{SILENCE_S}_10_",
            tool,
            STIFFNESS.get(motion),
            "jRelVel_0.9_",
            goal(START + 1.2 * TURN),
            start,
        ):
            if line is not None:
                self.say(line)
        served, goals = start == "startDirectServoJoints", START
        while self.speed < SPEED_M_S:
            self.wait(GOAL_S)
            if self.now > LONGEST_S:
                raise ValueError(f"{motion} reaches {self.speed:.2f} m/s")
            if served and self.arm.in_servo:
                goals = goals + SERVO_RAD_S * (2.5 if motion == "servo" else 1.0) * GOAL_S * TURN
                self.say(goal(goals))
            else:
                self.say("lrBeat_")
                self.arm.set_tool_force(np.array([0.0, 60.0, 0.0]) if start.startswith("lr") else np.zeros(3))

    @property
    def speed(self) -> float:
        """Speed of the tool point [m/s]."""
        return self.arm.robot.tool_speed(self.arm.q, self.arm.v, self.arm.T_flange_tool)

    def say(self, line: str) -> None:
        answer = self.application.receive(line, self.now)
        if answer.startswith(("no_", "nak")):
            raise ValueError(f"{line} is answered {answer}")

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / CYCLE_S)):
            self.now += CYCLE_S
            self.application.advance(self.now)

    def rest(self) -> tuple[float, float]:
        """Waits until the tool rests; returns after what time [ms] and how far from here [mm]."""
        begin, at = self.now, self.arm.tool[:3, 3]
        while self.speed > RESTING_M_S and self.now - begin < LONGEST_S:
            self.wait(CYCLE_S)
        return 1e3 * (self.now - begin), 1e3 * float(np.linalg.norm(self.arm.tool[:3, 3] - at))


def rows(quick: bool) -> list[Row]:
    """Returns time and way to rest of each motion, by cause."""
    return [row for motion in MOTIONS for row in _rows(motion)]


def _rows(motion: str) -> list[Row]:
    moving = Moving(motion)
    how = f"from {moving.speed:.2f} m/s, one run in simulated time"
    moving.application.stop()
    rest, way = moving.rest()
    silent = Moving(motion)
    begins = silent.now + SILENCE_S
    while not silent.application.events or "servo mode begins" in silent.application.events[-1]:
        silent.wait(CYCLE_S)
        if silent.application.mode == "ptp" and silent.arm.braking:
            break
    late = 1e3 * (silent.now - begins)
    held, beyond = silent.rest()
    released = []
    if motion == "hand guiding":
        guided = Moving(motion)
        guided.arm.enabling = False
        released = [number(f"{motion}, switch released: to rest", guided.rest()[0], "ms", how, REST)]
    return [
        *released,
        number(f"{motion}, stopped: to rest", rest, "ms", how, REST),
        number(f"{motion}, stopped: way", way, "mm", how, WAY),
        number(f"{motion}, silence: braking begins late by", late, "ms", how, BEGINS),
        number(f"{motion}, silence: to rest from there", held, "ms", f"{beyond:.0f} mm; {how}"),
    ]


def goal(q: np.ndarray) -> str:
    return f"jp_{'_'.join(map(str, q.tolist()))}_"

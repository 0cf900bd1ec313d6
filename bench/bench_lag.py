"""How far the simulated arm is behind a ramp of servo goals. Simulated time: the same on every machine."""

from __future__ import annotations

import numpy as np

from bench.measure import Row, row
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.robot import CYCLE_S, Robot
from rig_simulation.files import read_urdf

SPEEDS = (0.02, 0.1, 0.5)
CYCLES_PER_GOAL = 4
SETTLED_S = 1.0


def rows(quick: bool) -> list[Row]:
    """Returns the lag of joint 7 [ms] per law of the server and speed of the ramp."""
    robot = Robot(read_urdf("LBR7R800", "MF_elektrisch"))
    seconds = 1.5 if quick else 4.0
    table = []
    for law in ("lts", "none"):
        for speed in SPEEDS:
            behind = lag(SimulatedArm(robot, ArmSettings(servo_law=law)), speed, seconds)
            how = f"one joint, goals at 250 Hz, behind the ramp itself; {1e3 * np.median(behind):.2f} mrad"
            table.append(row(f"lag behind {speed:g} rad/s, law {law}", 1e3 * behind / speed, "ms", how))
    return table


def lag(arm: SimulatedArm, speed: float, seconds: float) -> np.ndarray:
    """Returns how far joint 7 is behind its ramp after each cycle, once it has settled [rad]."""
    arm.start_servo()
    behind = []
    for cycle in range(round(seconds / CYCLE_S)):
        if cycle % CYCLES_PER_GOAL == 0:
            arm.goal = np.array([0.0] * 6 + [speed * cycle * CYCLE_S])
        arm.step(CYCLE_S)
        behind.append(speed * (cycle + 1) * CYCLE_S - arm.q[6])
    return np.array(behind[round(SETTLED_S / CYCLE_S) :])

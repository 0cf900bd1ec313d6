"""How the goals come to rest from a motion at 0.5 m/s, by cause. Simulated time: the same on every machine.
Acceleration and jerk are those of the slowest joint; the limits of the faster ones are higher in proportion."""

from __future__ import annotations

import numpy as np

from bench.measure import Goal, Row, number
from bench.simulated import CLOCK_S, CYCLES_PER_GOAL, SimulatedRig
from common.poses import translation
from kuka_control.loop.commands import Inputs, Servo
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.switches import SwitchState
from rig_simulation.devices.sunrise.robot import CYCLE_S

CAUSES = ("control off", "exit", "time-out", "jump", "infeasible", "gap of 80 ms")
SPEED_M_S = 0.5
START_M = -0.14  # from the home position, to the left
CAUSE_S = 0.62  # when the cause comes, after the start of the stream [s]
CYCLES_PER_FRAME = 3
DT_S = CYCLES_PER_GOAL * CYCLE_S
GAP_S = 0.08
AFTER_GAP, REST = 60, 5  # goals looked at after a gap, and goals that stand still at the end of a stream
STARTING, MOST_CYCLES = 100, 20_000  # cycles before control is switched on and the stream begins; cycles in all
MOVING_M_S = 1e-4


def rows(quick: bool) -> list[Row]:
    """Returns the way to rest, and the largest acceleration and jerk, for each cause."""
    return [row for cause in CAUSES for row in _rows(cause)]


def _rows(cause: str) -> list[Row]:
    rig, times, goals, first = run(cause)
    limits = rig.config.joint_acceleration, rig.config.joint_jerk
    dt = np.diff(times)[:, None]
    speed = np.diff(goals, axis=0) / dt
    acceleration = np.diff(speed, axis=0) / dt[1:]
    jerk = np.diff(acceleration, axis=0) / dt[2:]
    slowest = rig.rig.model.max_speed / rig.rig.model.max_speed.min()
    begin = max(first - 2, 0)
    largest = [float(np.max(np.abs(x[max(begin - i, 0) :]) / slowest)) for i, x in enumerate((acceleration, jerk))]
    how = f"from {SPEED_M_S:g} m/s to rest, one run in simulated time"
    points = np.array([rig.rig.kinematics.forward(q)[:3, 3] for q in goals])
    moving = np.nonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) / dt[:, 0] > MOVING_M_S)[0]
    table = []
    if first > 0:
        way, duration = points[-1] - points[first - 1], times[moving[-1] + 1] - times[first - 1]
        length = 1e3 * float(np.linalg.norm(way))
        table.append(number(f"stop by {cause}: way", length, "mm", f"{how}; {duration:.2f} s"))
    units = (("acceleration", "rad/s^2"), ("jerk", "rad/s^3"))
    return table + [
        number(f"stop by {cause}: {what}", value, unit, how, Goal(limit))
        for (what, unit), value, limit in zip(units, largest, limits)
    ]


def run(cause: str) -> tuple[SimulatedRig, np.ndarray, np.ndarray, int]:
    """Returns the rig, the times of its goals [s], the goals, shape (n, 7) [rad], and the number of those before the
    cause came; of a gap only the goals after it."""
    rig = SimulatedRig("none", time_out=0.2).at_home()
    rig.newest, rig.start = None, np.inf
    home = rig.rig.kinematics.forward(rig.rig.home.q)
    times: list[float] = []
    goals: list[np.ndarray] = []
    first, came = 0, False
    for count in range(MOST_CYCLES):
        if rig.controller.in_servo and not np.isfinite(rig.start):
            rig.start = rig.now
        elapsed = max(rig.now - rig.start, 0.0)
        if elapsed >= CAUSE_S and not came:
            first, came = len(goals), True
            if cause == CAUSES[5]:
                _advance(rig, GAP_S)
        if count > STARTING and count % CYCLES_PER_FRAME == 0 and not (came and cause == "time-out"):
            rig.newest = DesiredFrame(_tool(home, elapsed, cause if came else ""), CLOCK_S + rig.now)
        control_on = count >= STARTING and not (came and cause == "control off")
        switches = SwitchState(control_on, int(count >= STARTING), exit_requested=came and cause == "exit")
        inputs = Inputs(rig.newest, CLOCK_S + rig.now, switches)
        rig.step = rig.controller.cycle(inputs, rig.now)
        if isinstance(rig.step.command, Servo) and np.isfinite(rig.start):
            times.append(rig.now)
            goals.append(np.array(rig.loop.goal))
        _advance(rig, DT_S)
        if came and (not rig.controller.in_servo or (cause == CAUSES[5] and len(goals) > first + AFTER_GAP)):
            break
    if cause == CAUSES[5]:  # before the first goal after a gap, the goals stood still
        q = [goals[first - 1]] * 3 + goals[first:]
        return rig, np.concatenate([times[first] - DT_S * np.arange(3, 0, -1), times[first:]]), np.array(q), 0
    times += [times[-1] + DT_S * i for i in range(1, REST + 1)]  # the last goal stays
    return rig, np.array(times), np.array(goals + [goals[-1]] * REST), first


def _advance(rig: SimulatedRig, seconds: float) -> None:
    for _ in range(round(seconds / CYCLE_S)):
        rig.joints.step(CYCLE_S)
    if not rig.controller.in_servo:
        rig.arm.read()
    rig.now += seconds


def _tool(home: np.ndarray, t: float, cause: str) -> np.ndarray:
    """Returns the desired tool at a time after the start [s]; the causes jump and infeasible move it away."""
    along = START_M + SPEED_M_S * (t - 0.25 if t > 0.5 else t * t)
    away = {"jump": (0.0, 0.0, -0.15), "infeasible": (-0.9, 0.9, 0.0)}.get(cause, (0.0, 0.0, 0.0))
    return translation(*away) @ translation(along / np.sqrt(2.0), along / np.sqrt(2.0), 0.0) @ home

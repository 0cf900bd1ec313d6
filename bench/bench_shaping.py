"""What shaping costs and what it spares, and how far the arm is behind its goals and the hand. Simulated time: the same
on every machine."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from bench.bench_filter import reaches, sample, tremor
from bench.measure import BenchError, Goal, Peer, Row, number, row
from bench.simulated import CYCLES_PER_GOAL, SimulatedRig
from common.hand_delay import HandDelay, Track, hand_delay
from common.poses import pose
from kuka_control.loop.servo_law import LtsGoals
from leap_kuka.hand_average import HandAverage
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.robot import CYCLE_S, Robot
from rig_simulation.files import read_urdf

RAMPS_RAD_S = (0.02, 0.1, 0.5)
RADIUS_M = 0.06
SETTLED_S = 2.0
RATES_HZ = (74.0, 115.0)
REACH_SCALE = 0.5  # of the reaches of 20 cm; the whole ones are faster than the arm may follow
HAND_S = 20.0


def rows(quick: bool) -> list[Row]:
    """Returns the lag and the largest acceleration of the goals beside those without shaping, and the arm's lag with
    compensation of the servo law beside that without."""
    seconds = 3.0 if quick else 6.0
    table = []
    for rate in RATES_HZ[:1] if quick else RATES_HZ:
        for hertz in (1.0,) if quick else (0.25, 1.0):
            table += _circle(rate, hertz, seconds)
    robot = Robot(read_urdf("LBR7R800", "MF_elektrisch"))
    for speed in RAMPS_RAD_S:
        without, behind = (
            1e3 * lag(SimulatedArm(robot, ArmSettings(servo_law="lts")), servo_law, speed, min(seconds, 4.0)) / speed
            for servo_law in ("none", "lts")
        )
        how = "one joint behind its ramp, law lts in the controller; peer: without compensation"
        peer = Peer("none", float(np.median(without)))
        table.append(row(f"lag at {speed:g} rad/s, servo_law lts", behind, "ms", how, peer=peer))
    return [*table, _hand_to_arm(8.0 if quick else HAND_S)]


def _hand_to_arm(seconds: float) -> Row:
    shipped, before = (_delay(seconds, name, servo_law) for name, servo_law in (("kalman", "auto"), ("mean", "none")))
    how = (
        f"{shipped.windows} windows of 4 s, reaches with tremor at {RATES_HZ[1]:g} Hz; second number: 90th percentile; "
        "filter, target chain, limits, servo law and simulated drives, no wires; peer: filter mean, servo_law none"
    )
    peer = Peer("as in 2019", 1e3 * before.median)
    return Row("palm to tool, simulated time", 1e3 * shipped.median, 1e3 * shipped.high, "ms", how, Goal(45.0), peer)


def _delay(seconds: float, filter: str, servo_law: str) -> HandDelay:
    """Returns the delay of the simulated arm's tool behind the palm; BenchError where too little moved."""
    times = np.arange(0.0, seconds + 0.1, 1.0 / RATES_HZ[1])
    palms = REACH_SCALE * reaches(times)[0]
    hands = iter(zip(times.tolist(), palms + tremor(times)))
    rig = SimulatedRig(servo_law=servo_law).at_home()
    home, average = rig.rig.kinematics.forward(rig.rig.home.q), HandAverage(10, filter)

    def tool(_: float) -> np.ndarray:
        now, palm = next(hands)
        average.add(sample(palm), now)
        mean = average.mean()
        return pose(home[:3, :3], home[:3, 3] + ((palm if mean is None else mean.palm) - sample(np.zeros(3)).palm))

    rig.follow(seconds, tool, RATES_HZ[1])
    palm_track, tool_track = Track(), Track()
    for track, at, points in (
        (palm_track, times, palms),
        (tool_track, rig.times, [rig.rig.kinematics.forward(q)[:3, 3] for q in rig.q]),
    ):
        for now, point in zip(at.tolist(), points):
            track.add(now, point.tolist())
    found = hand_delay(palm_track, tool_track)
    if found is None:
        raise BenchError("The simulated arm did not follow the hand.")
    return found


def _circle(rate: float, hertz: float, seconds: float) -> list[Row]:
    speed = 2.0 * np.pi * hertz * RADIUS_M
    measured = {}
    for shaping in ("ruckig", "none"):
        rig = SimulatedRig(shaping=shaping).at_home()
        home = rig.rig.kinematics.forward(rig.rig.home.q)
        tool = partial(on_circle, home, hertz)
        rig.follow(seconds, tool, rate)
        settled = rig.times > SETTLED_S
        goals = np.array([rig.rig.kinematics.forward(q)[:3, 3] for q in rig.goals[settled]])
        jolts = np.abs(np.diff(rig.goals[settled], n=2, axis=0)) / (CYCLES_PER_GOAL * CYCLE_S) ** 2
        measured[shaping] = 1e3 * path_lag(goals, rig.times[settled], tool, speed), float(jolts.max())
    how = f"circle at {speed:.2f} m/s, frames at {rate:g} Hz; peer: shaping none"
    what = f"{speed:.2f} m/s, {rate:g} Hz"
    (behind, largest), (plain_behind, plain_largest) = measured["ruckig"], measured["none"]
    lag_of_plain, jolt_of_plain = Peer("none", float(np.median(plain_behind))), Peer("none", plain_largest)
    return [
        row(f"goals {what}: lag", behind, "ms", how, peer=lag_of_plain),
        number(f"goals {what}: acceleration", largest, "rad/s^2", how, peer=jolt_of_plain),
    ]


def path_lag(points: np.ndarray, times: np.ndarray, tool: Callable[[float], np.ndarray], speed: float) -> np.ndarray:
    """Returns how long ago each point was wanted [s]: its distance behind, along the way, by the speed.

    Args:
        points: shape (n, 3) [m].
        times: of the points, shape (n,) [s].
        tool: the tool frame that was wanted, shape (4, 4) [m], at a time [s].
        speed: along the way [m/s]."""
    along = np.array([tool(t + 1e-4)[:3, 3] - tool(t - 1e-4)[:3, 3] for t in times])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.sum((np.array([tool(t)[:3, 3] for t in times]) - points) * along, axis=1) / speed


def on_circle(home: np.ndarray, hertz: float, t: float) -> np.ndarray:
    """Returns the tool frame, shape (4, 4) [m], that starts at home, smoothly within the first second."""
    angle = 2.0 * np.pi * hertz * (t if t > 1.0 else t * t * (2.0 - t))
    return pose(home[:3, :3], home[:3, 3] + RADIUS_M * np.array([0.0, np.sin(angle), 1.0 - np.cos(angle)]))


def lag(arm: SimulatedArm, servo_law: str, speed: float, seconds: float) -> np.ndarray:
    """Returns how far joint 7 is behind its ramp after each cycle, once it has settled [rad]."""
    arm.start_servo()
    goals = LtsGoals(arm.robot.lower, arm.robot.upper)
    measured, behind = arm.q, []
    for cycle in range(round(seconds / CYCLE_S)):
        if cycle % CYCLES_PER_GOAL == 0:
            wanted, v = np.zeros(7), np.zeros(7)
            wanted[6], v[6] = speed * cycle * CYCLE_S, speed
            sent = goals.step(wanted, v, measured, CYCLES_PER_GOAL * CYCLE_S)
            measured = arm.q
            arm.goal = sent if servo_law == "lts" else wanted
        arm.step(CYCLE_S)
        behind.append(speed * (cycle + 1) * CYCLE_S - arm.q[6])
    return np.array(behind[round(SETTLED_S / CYCLE_S) :])

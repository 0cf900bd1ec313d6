"""The largest force on a post in the way of a PTP motion, by what ends the motion. Simulated time: the same everywhere.
The arm turns one joint or several on its way home, towards a post that stands fast. Nothing ends the motion, or the
cabinet's stop at 25 Nm, or the torque ranges of the controllers alone (ptp_contact_torque)."""

from __future__ import annotations

import math

import numpy as np

from bench.measure import Row, number
from bench.simulated import SimulatedRig
from kuka_control.loop.assembly import ptp_torque_ranges
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.motions import leaves_torque_ranges
from rig_simulation.devices.sunrise.paths import JointMove
from rig_simulation.devices.sunrise.robot import CYCLE_S, Robot
from rig_simulation.files import read_scene, read_urdf
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.parts import ArmJoints, HandPart
from rig_simulation.world.physics import World
from rig_simulation.world.scene import scene_from, table_pose

HOME_DEG = np.array([-45.0, 30.0, 0.0, -80.0, 0.0, 70.0, 0.0])
# From where the arm turns home [deg], how far on that way of the palm the post stands, and its height [m].
MOTIONS = {
    "joint 1": ([50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.5, 1.2),
    "joint 2, down": ([0.0, -35.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 0.28),
    "joint 3": ([0.0, 0.0, 70.0, 0.0, 0.0, 0.0, 0.0], 0.5, 1.2),
    "joints 1 to 6": ([40.0, -15.0, 10.0, -15.0, 10.0, 15.0, 0.0], 0.5, 1.2),
}
VELOCITIES = (0.1, 0.15, 0.25)
RADIUS_M = 0.03
CASES = {"nothing": (math.inf, False), "the stop at 25 Nm": (25.0, False), "a contact": (math.inf, True)}
"""What ends the motion: the torque of the cabinet's stop [Nm], and whether its ranges do."""
PALM_M = 0.1  # from the flange
LONGEST_S, PRESSES_S = 12.0, 1.0  # of a motion; afterwards the arm presses on [s]


def rows(quick: bool) -> list[Row]:
    """Returns the largest force of each motion at each velocity, by what ends it."""
    table = []
    for motion, (away, part, height) in list(MOTIONS.items())[: 1 if quick else None]:
        for velocity in VELOCITIES[: 1 if quick else None]:
            for case, (limit, guarded) in CASES.items():
                greatest, standing = pushed(np.radians(away), part, height, velocity, limit, guarded)
                how = f"{standing:.0f} N where it stands; a rigid post, {motion} home, simulated"
                table.append(number(f"{motion} at {velocity:g}, ended by {case}", greatest, "N", how))
    return table


def pushed(
    away: np.ndarray, part: float, height: float, velocity: float, limit: float, guarded: bool
) -> tuple[float, float]:
    """Returns the largest force on the post and that of the standing arm [N]; see CASES."""
    home = np.radians(HOME_DEG)
    robot, scene = Robot(read_urdf("LBR7R800", "MF_elektrisch")), read_scene("empty")
    world = World(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), scene))
    world.add(HandPart())
    arm = SimulatedArm(robot, ArmSettings(limit, math.inf), ArmJoints(world, pairs=True))
    _go(arm, home + away, 0.2)
    palm = robot.flange(home + (1.0 - part) * away) @ [0.0, 0.0, PALM_M, 1.0]
    place = np.linalg.inv(table_pose(scene_from(scene).table)) @ palm
    post = {"position": place[:2].tolist(), "radius": RADIUS_M, "height": height}
    world.set_scene({**scene, "posts": {"post": post}})
    rig = SimulatedRig()
    ranges = ptp_torque_ranges(rig.config, rig.rig)
    assert ranges is not None, "they are on as shipped"
    guard = leaves_torque_ranges(np.column_stack([range(7), ranges(arm.q, home, velocity, 0.0)])) if guarded else None
    arm.start_motion(JointMove(arm.q, home, velocity * robot.max_speed, arm.motion_acceleration), guard)
    forces = [0.0]
    while arm.in_motion and len(forces) * CYCLE_S < LONGEST_S and arm.safety_stop is None:
        arm.step(CYCLE_S)
        forces.append(_force(world))
    for _ in range(round(PRESSES_S / CYCLE_S)):
        arm.step(CYCLE_S)
        forces.append(_force(world))
    return max(forces), forces[-1]


def _go(arm: SimulatedArm, q: np.ndarray, velocity: float) -> None:
    arm.start_motion(JointMove(arm.q, q, velocity * arm.robot.max_speed, arm.motion_acceleration))
    while arm.in_motion:
        arm.step(CYCLE_S)
        if arm.safety_stop is not None:
            raise ValueError(f"The motion does not begin where it should: {arm.safety_stop}")


def _force(world: World) -> float:
    return sum(contact["force"] for contact in world.contacts() if "post/post" in contact["bodies"])

"""Lifting in MuJoCo: a parallel gripper goes to a grasp along its approach, closes, and lifts straight up.

What the physics can say is bounded by its contact model: rigid bodies, Coulomb friction.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from common.rotations import quaternion_from_rotation
from grasping.lab.synthetic.labels import Gripper
from grasping.lab.synthetic.scene import HeapScene, world_xml, xml_text

START_M = 0.12  # the hand starts so far before the grasp
LIFT_M = 0.15
RISE_M = 0.08  # an object that rose so much was lifted
FORCE_N = 10.0  # of each finger
TIMES_S = (0.4, 0.5, 0.8, 0.3)  # approach, close, lift, hold
FINGER_M = 0.07
HOLD_N = 80.0  # greatest force of the hand along its approach and its lift: a hand on an obstacle stops
STEP_S = 0.002

HAND = """<body name="carriage" pos="{pos}" quat="{quat}" gravcomp="1">
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<joint name="lift" type="slide" axis="{up}" damping="200"/>
<body name="hand" gravcomp="1"><joint name="approach" type="slide" axis="0 0 1" damping="200"/>
<geom type="box" size="{half_palm} {half_breadth} 0.01" pos="0 0 {palm_z}" mass="0.5"/>
{fingers}</body></body>"""
FINGER = """<body name="finger{n}" pos="{x} 0 0" gravcomp="1">
<joint name="finger{n}" type="slide" axis="{side} 0 0" damping="20" range="0 {travel}"/>
<geom type="box" size="{half_thickness} {half_breadth} {half_length}" pos="0 0 {z}" density="6000"/></body>"""
REST = """<equality><joint joint1="finger0" joint2="finger1" polycoef="0 1 0 0 0" solref="0.004 1"/></equality>
<contact><exclude body1="hand" body2="finger0"/><exclude body1="hand" body2="finger1"/></contact>
<actuator><position joint="approach" kp="20000" forcerange="-{hold} {hold}"/>
<position joint="lift" kp="20000" forcerange="-{hold} {hold}"/>
<motor joint="finger0"/><motor joint="finger1"/></actuator>"""


class LiftResult(NamedTuple):
    """What came of a trial."""

    lifted: bool  # an object rose by more than `RISE_M` and was still up at the end
    rise: float  # of the object that rose most [m]
    reached: bool  # the hand came within 5 mm of the grasp before it closed


def lift(scene: HeapScene, T_world_grasp: np.ndarray, opening: float, gripper: Gripper, friction: float) -> LiftResult:
    """Returns what happens when the gripper grasps there, its pads `opening` [m] apart, at most what it has.

    `T_world_grasp`: surface point between the fingers, z the approach, x through both, shape (4, 4) [m].
    """
    opening = float(np.clip(opening, 0.005, gripper.opening))
    R, approach = T_world_grasp[:3, :3], T_world_grasp[:3, 2]
    tip = T_world_grasp[:3, 3] + gripper.reach * approach
    if tip[2] < gripper.ground:
        tip = tip + (gripper.ground - tip[2]) / approach[2] * approach
    start = tip - START_M * approach
    model = mujoco.MjModel.from_xml_string(_xml(scene, R, start, opening, gripper, friction))
    model.opt.timestep = STEP_S
    data = mujoco.MjData(model)
    data.qpos[: len(scene.state)] = scene.state
    mujoco.mj_forward(model, data)
    heights = [int(a) for a in model.jnt_qposadr[: len(scene.objects)] + 2]
    before = data.qpos[heights].copy()
    approach_at = model.joint("approach").qposadr[0]
    force = -FORCE_N, FORCE_N  # [N] of each finger: against its stop, then inwards
    reached = False
    for phase, duration in enumerate(TIMES_S):
        steps = int(duration / STEP_S)
        for i in range(steps):
            done = (i + 1) / steps
            data.ctrl[0] = START_M * (done if phase == 0 else 1.0)
            data.ctrl[1] = LIFT_M * (done if phase == 2 else float(phase == 3))
            data.ctrl[2:] = force[min(phase, 1)]
            mujoco.mj_step(model, data)
        if phase == 0:
            reached = abs(data.qpos[approach_at] - START_M) < 0.005
    rise = data.qpos[heights] - before
    most = float(rise.max()) if np.all(np.isfinite(rise)) else 0.0
    return LiftResult(most > RISE_M and not data.warning.number.any(), most, reached)


def _xml(scene: HeapScene, R: np.ndarray, start: np.ndarray, opening: float, gripper: Gripper, friction: float) -> str:
    """Returns the scene's world with the hand in it; the hand's origin is between the tips."""
    half = 0.5 * gripper.thickness
    fingers = "".join(
        FINGER.format(
            n=n,
            side=-side,
            travel=0.5 * opening,
            x=side * (0.5 * opening + half),
            half_thickness=half,
            half_breadth=0.5 * gripper.breadth,
            half_length=0.5 * FINGER_M,
            z=-0.5 * FINGER_M,
        )
        for n, side in enumerate((-1.0, 1.0))
    )
    quaternion = quaternion_from_rotation(R)[[3, 0, 1, 2]]
    hand = HAND.format(
        pos=xml_text(start),
        quat=xml_text(quaternion),
        up=xml_text(R.T @ (0.0, 0.0, 1.0)),
        half_palm=0.5 * gripper.opening + gripper.thickness,
        half_breadth=0.75 * gripper.breadth,
        palm_z=-FINGER_M - 0.01,
        fingers=fingers,
    )
    return world_xml(scene.objects, friction, noslip=5, bodies=hand, rest=REST.format(hold=HOLD_N))

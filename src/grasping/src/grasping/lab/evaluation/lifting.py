"""Lifting in MuJoCo: a parallel gripper goes to a grasp along its approach, closes, lifts straight up, and may shake.

What the physics can say is bounded by its contact model: rigid bodies, Coulomb friction.
"""

from __future__ import annotations

import mujoco
import numpy as np

from common import lift_trial
from common.rotations import quaternion_from_rotation
from grasping.lab.synthetic.scene import HeapScene, world_xml, xml_text
from grasping.poses.gripper import Gripper

FINGER_M = 0.07  # length of a finger
START_M = 0.12  # the hand starts so far before the grasp
TIMES_S = (0.4, 0.5, 0.8, 0.3, lift_trial.SHAKE_S)  # of `lift_trial.PHASES`

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


def lift(
    scene: HeapScene,
    T_world_grasp: np.ndarray,
    opening: float,
    gripper: Gripper,
    friction: float,
    target: int | None = None,
    shake: bool = False,
) -> lift_trial.LiftResult:
    """Returns what happens when the gripper grasps there, its pads `opening` [m] apart, at most what it has.
    `T_world_grasp`: surface point between the fingers, z the approach, x through both, shape (4, 4) [m]; `target`: the
    object that the grasp is meant for, None: whichever rises most; `shake`: the hand is shaken after the lift.
    """
    rise_m = 0.08  # an object that rose so much was lifted
    step_s = 0.002
    opening = float(np.clip(opening, 0.005, gripper.opening))
    R, approach = T_world_grasp[:3, :3], T_world_grasp[:3, 2]
    tip = T_world_grasp[:3, 3] + gripper.reach * approach
    if tip[2] < gripper.ground:
        tip = tip + (gripper.ground - tip[2]) / approach[2] * approach
    start = tip - START_M * approach
    model = mujoco.MjModel.from_xml_string(_xml(scene, R, start, opening, gripper, friction))
    model.opt.timestep = step_s
    record = lift_trial.lift(ParallelHand(model, scene), TIMES_S, step_s, shake)
    return lift_trial.judged(record, target, rise_m)


class ParallelHand:
    """The parallel gripper above a scene, a `lift_trial.LiftingHand`."""

    def __init__(self, model: mujoco.MjModel, scene: HeapScene) -> None:
        self._model, self._count = model, len(scene.objects)
        self._data = mujoco.MjData(model)
        self._data.qpos[: len(scene.state)] = scene.state
        mujoco.mj_forward(model, self._data)

    def step(self, approach: float, lift: float, closing: bool, gravity: np.ndarray) -> None:
        lift_m = 0.15
        force_n = 10.0  # of each finger
        self._model.opt.gravity[:] = gravity
        self._data.ctrl[:2] = START_M * approach, lift_m * lift
        self._data.ctrl[2:] = force_n if closing else -force_n
        mujoco.mj_step(self._model, self._data)

    def places(self) -> np.ndarray:
        return self._data.qpos[: 7 * self._count].reshape(-1, 7)[:, :3].copy()

    def missing(self) -> float:
        return float(self._data.joint("approach").qpos[0] - START_M)

    def held(self) -> np.ndarray:
        bodies = self._model.geom_bodyid[self._data.contact.geom]
        pairs = {(int(a), int(b)) for a, b in np.concatenate([bodies, bodies[:, ::-1]])}
        fingers = [self._model.body(f"finger{n}").id for n in range(2)]
        objects = [self._model.body(f"object{i}").id for i in range(self._count)]
        return np.array([all((finger, body) in pairs for finger in fingers) for body in objects])

    def valid(self) -> bool:
        return not self._data.warning.number.any()


def nearest_object(scene: HeapScene, point: np.ndarray) -> int:
    """Returns the number of the object whose surface is nearest to a point of the world, shape (3,) [m]."""
    far_m = 2.0  # distances of objects to a grasp are looked for up to this
    dot = f'<body pos="{xml_text(point)}"><geom type="sphere" size="0.0005" contype="0" conaffinity="0"/></body>'
    model = mujoco.MjModel.from_xml_string(world_xml(scene.objects, bodies=dot))
    data = mujoco.MjData(model)
    data.qpos[:] = scene.state
    mujoco.mj_kinematics(model, data)
    dot_geom = model.ngeom - 1
    distances = {
        geom: mujoco.mj_geomDistance(model, data, dot_geom, geom, far_m, None) for geom in range(1, model.ngeom - 1)
    }
    return int(model.geom_bodyid[min(distances, key=distances.__getitem__)]) - 1


def _xml(scene: HeapScene, R: np.ndarray, start: np.ndarray, opening: float, gripper: Gripper, friction: float) -> str:
    """Returns the scene's world with the hand in it; the hand's origin is between the tips."""
    hold_n = 80.0  # greatest force of the hand along its approach and its lift: a hand on an obstacle stops
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
    return world_xml(scene.objects, friction, 5, hand, REST.format(hold=hold_n), scene.fixed)

"""What displays of the world share: contact forces, plain shapes for programs without MuJoCo, options, the free camera.

Forces: one arrow and one label for each pair of bodies, for all their contacts together. Arrows are placed where they
are visible: forces of the robot end where they act, outside its fingers; all others start there, so that the force of a
table rises out of the object.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from common import clock
from common.command_line import finite, port, positive, stop_on_signals
from common.errors import DeviceError
from common.frames import BASE
from common.poses import inverse, pose, read_only
from rig_simulation.control_port import ControlClient
from rig_simulation.world.physics import ROBOT

METRES_PER_NEWTON = 0.06
LONGEST_M = 0.3
LEAST_N = 0.02


@dataclass(frozen=True)
class Arrow:
    """The total force of all contacts of two bodies, as an arrow in its direction on the first body."""

    tail: np.ndarray  # shape (3,) [m] in the world
    tip: np.ndarray  # shape (3,) [m] in the world
    by_robot: bool  # whether one body is the robot; then the force acts at the tip, else at the tail


@dataclass(frozen=True)
class PairForce:
    """The total force of all contacts of two bodies."""

    bodies: tuple[str, str]  # their names; the force acts on the first
    position: np.ndarray  # mean of the contacts, weighted by their forces, shape (3,) [m] in the world
    newtons: float  # sum of the forces along the normals [N]
    force: np.ndarray  # their vector sum, on the first body, shape (3,) [N]
    by_robot: bool  # as in Arrow


def arrows(pairs: Sequence[PairForce]) -> list[Arrow]:
    """Returns the arrows of forces; forces that cancel each other have none."""
    found = []
    for pair in pairs:
        newtons = float(np.linalg.norm(pair.force))
        if newtons < LEAST_N:
            continue
        arrow = min(METRES_PER_NEWTON, LONGEST_M / newtons) * pair.force
        tail = pair.position - arrow if pair.by_robot else pair.position
        found.append(Arrow(read_only(tail), read_only(tail + arrow), pair.by_robot))
    return found


def pair_forces(contacts: Sequence[Mapping[str, Any]]) -> list[PairForce]:
    """Returns the forces of pairs of bodies, sorted by names, from the contacts of the world's control port."""
    pairs: dict[tuple[str, str], list[tuple[float, np.ndarray, np.ndarray]]] = {}
    for contact in contacts:
        first, second = contact["bodies"]
        # The order of display, an object first, and the sign of the force on the first body
        swapped = second.startswith("object/") or not first.startswith("object/")
        bodies, sign = ((second, first), 1.0) if swapped else ((first, second), -1.0)
        newtons, position, normal = contact["force"], np.array(contact["position"]), np.array(contact["normal"])
        pairs.setdefault(bodies, []).append((newtons, position, sign * newtons * normal))
    found = []
    for bodies, all_acting in sorted(pairs.items()):
        total = sum(newtons for newtons, _, _ in all_acting)
        if total >= LEAST_N:
            centre = np.sum([newtons * position for newtons, position, _ in all_acting], axis=0) / total
            force = np.sum([force for _, _, force in all_acting], axis=0)
            by_robot = any(ROBOT.match(body) for body in bodies)
            found.append(PairForce(bodies, read_only(centre), total, read_only(force), by_robot))
    return found


def short(body: str) -> str:
    """Returns the name of a body without its group."""
    return body.partition("/")[2] or body


BOX, BALL, CYLINDER = "box", "ball", "cylinder"
_KINDS = {mujoco.mjtGeom.mjGEOM_BOX: BOX, mujoco.mjtGeom.mjGEOM_SPHERE: BALL, mujoco.mjtGeom.mjGEOM_CYLINDER: CYLINDER}


@dataclass(frozen=True)
class Shape:
    """A part of a body."""

    body: str  # such as table or object/cup
    kind: str  # BOX, BALL or CYLINDER; a cylinder's axis is its z
    size: np.ndarray  # extents along its own axes, shape (3,) [m]
    T_base_shape: np.ndarray  # pose in kuka/base_frame, shape (4, 4)
    colour: tuple[float, ...]  # red, green, blue, alpha, 0..1.


def beyond(parts: Sequence[Shape], towards: np.ndarray, clearance: float) -> np.ndarray:
    """Returns the point from the middle of a body, given by all its shapes, in the direction `towards`, a unit vector
    in kuka/base_frame, shape (3,), `clearance` [m] beyond the body's farthest point."""
    middle = np.mean([part.T_base_shape[:3, 3] for part in parts], axis=0)
    ends = [
        towards @ part.T_base_shape[:3, 3] + np.abs(towards @ part.T_base_shape[:3, :3]) @ part.size / 2.0
        for part in parts
    ]
    return middle + (max(ends) - towards @ middle + clearance) * towards


def base_pose(data: mujoco.MjData) -> np.ndarray:
    """Returns the pose in the world of kuka/base_frame, of several robots that of the frame world, shape (4, 4)."""
    try:
        body = data.body(BASE)
    except KeyError:
        return np.eye(4)
    return pose(body.xmat.reshape(3, 3), body.xpos)


def shapes(model: mujoco.MjModel, data: mujoco.MjData) -> list[Shape]:
    """Returns the shapes of the table and of all objects of the world; `data`: with computed kinematics."""
    smallest_m = 0.004  # smaller balls, the feet of objects, are not shown
    T_base_world = inverse(base_pose(data))
    found = []
    for geom in range(model.ngeom):
        body = model.body(model.geom_bodyid[geom]).name
        kind = _KINDS.get(model.geom_type[geom])
        if kind is None or not (body == "table" or body.startswith("object/")):
            continue
        half = model.geom_size[geom]
        if kind == BALL and half[0] < smallest_m:
            continue
        extents = {BOX: half, BALL: half[[0, 0, 0]], CYLINDER: half[[0, 0, 1]]}[kind]
        T_world_shape = pose(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
        colour = tuple(model.geom_rgba[geom].tolist())
        found.append(Shape(body, kind, read_only(2.0 * extents), read_only(T_base_world @ T_world_shape), colour))
    return found


HOST = "127.0.0.1"
TIMEOUT_S = 2.0
RETRY_S = 0.2
PATIENCE_S = 20.0  # longest time without an answer from a running world
NICENESS = 10  # displays must not take the processor from the rig
OF_ROBOT, OF_OTHERS = np.array([1.0, 0.45, 0.0, 1.0]), np.array([0.35, 0.65, 1.0, 1.0])


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--port", type=port, default=30021, help="control port of the world")
    add("--rate", type=positive, default=20.0, help="images a second")
    add("--wait", type=positive, default=60.0, metavar="S", help="longest time to wait for the world")
    names, view = ("AZIMUTH", "ELEVATION", "DISTANCE"), "position of the camera: degrees, degrees, m"
    add("--view", type=finite, nargs=3, default=(150.0, -20.0, 1.6), metavar=names, help=view)


def stop_when_interrupted() -> clock.Event:
    """Returns an event that Ctrl-C and SIGTERM set."""
    stop = clock.Event()
    stop_on_signals(stop.set)
    return stop


def wait_for_world(client: ControlClient, longest: float, stop: clock.Event) -> None:
    """Waits until the world answers or `stop` is set; raises DeviceError after `longest` seconds."""
    deadline = clock.monotonic() + longest
    while not stop.is_set():
        try:
            client.ask("state")
            return
        except DeviceError:
            if clock.monotonic() > deadline:
                raise
        stop.wait(RETRY_S)


def point_camera(camera: mujoco.MjvCamera, view: tuple[float, float, float], data: mujoco.MjData) -> None:
    """Points a free camera above the table, from the azimuth, elevation [deg] and distance [m] of `view`."""
    above_table_m = 0.25
    camera.azimuth, camera.elevation, camera.distance = view
    table, base = data.body("table").xpos, base_pose(data)[:3, 3]
    camera.lookat[:] = (*(0.8 * table[:2] + 0.2 * base[:2]), table[2] + above_table_m)


def add_arrows(scene: mujoco.MjvScene, arrows: Sequence[Arrow]) -> None:
    """Adds arrows to a scene, as many as it has room for."""
    width_m = 0.009
    drawn_length = 2.0  # MuJoCo 3.2.3 draws an arrow at half the length of its connector
    for arrow in arrows[: scene.maxgeom - scene.ngeom]:
        geom = scene.geoms[scene.ngeom]
        colour = OF_ROBOT if arrow.by_robot else OF_OTHERS
        mujoco.mjv_initGeom(
            geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.zeros(9), colour.astype(np.float32)
        )
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, width_m, arrow.tail, arrow.tip)
        geom.size[2] *= drawn_length
        scene.ngeom += 1

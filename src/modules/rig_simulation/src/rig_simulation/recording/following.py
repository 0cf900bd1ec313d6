"""Common parts of the programs that show the world: options, waiting for it, the free camera, arrows of forces."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Sequence

import mujoco
import numpy as np

from common.errors import DeviceError
from common.frames import BASE
from rig_simulation.command_line import finite, port, positive, stop_on_signals
from rig_simulation.control_port import ControlClient
from rig_simulation.recording.forces import Arrow

HOST = "127.0.0.1"
TIMEOUT_S = 2.0
RETRY_S = 0.2
PATIENCE_S = 20.0
"""Longest time without an answer from a running world."""
ABOVE_TABLE_M = 0.25
NICENESS = 10
"""Displays must not take the processor from the rig."""

WIDTH_M = 0.009
DRAWN_LENGTH = 2.0
"""MuJoCo 3.2.3 draws an arrow at half the length of its connector."""
OF_ROBOT, OF_OTHERS = np.array([1.0, 0.45, 0.0, 1.0]), np.array([0.35, 0.65, 1.0, 1.0])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of both programs."""
    add = parser.add_argument
    add("--port", type=port, default=30021, help="control port of the world")
    add("--rate", type=positive, default=20.0, help="images a second")
    add("--wait", type=positive, default=60.0, metavar="S", help="longest time to wait for the world")
    names, view = ("AZIMUTH", "ELEVATION", "DISTANCE"), "position of the camera: degrees, degrees, m"
    add("--view", type=finite, nargs=3, default=(150.0, -20.0, 1.6), metavar=names, help=view)


def stop_when_interrupted() -> threading.Event:
    """Returns an event that Ctrl-C and SIGTERM set."""
    stop = threading.Event()
    stop_on_signals(stop.set)
    return stop


def wait_for_world(client: ControlClient, longest: float, stop: threading.Event) -> None:
    """Waits until the world answers, or `stop` is set.

    Raises:
        DeviceError: it does not answer within `longest` seconds.
    """
    deadline = time.monotonic() + longest
    while not stop.is_set():
        try:
            client.ask("state")
            return
        except DeviceError:
            if time.monotonic() > deadline:
                raise
        stop.wait(RETRY_S)


def point_camera(camera: mujoco.MjvCamera, view: tuple[float, float, float], data: mujoco.MjData) -> None:
    """Points a free camera above the table, from the azimuth, elevation [deg] and distance [m] of `view`."""
    camera.azimuth, camera.elevation, camera.distance = view
    table, base = data.body("table").xpos, data.body(BASE).xpos
    camera.lookat[:] = (*(0.8 * table[:2] + 0.2 * base[:2]), table[2] + ABOVE_TABLE_M)


def add_arrows(scene: mujoco.MjvScene, arrows: Sequence[Arrow]) -> None:
    """Adds arrows to a scene, as many as it has room for."""
    for arrow in arrows[: scene.maxgeom - scene.ngeom]:
        geom = scene.geoms[scene.ngeom]
        colour = OF_ROBOT if arrow.by_robot else OF_OTHERS
        mujoco.mjv_initGeom(
            geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.zeros(9), colour.astype(np.float32)
        )
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, WIDTH_M, arrow.tail, arrow.tip)
        geom.size[2] *= DRAWN_LENGTH
        scene.ngeom += 1

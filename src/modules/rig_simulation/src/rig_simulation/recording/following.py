"""What the programs that show the world have in common: how they find it, and from where they look."""

from __future__ import annotations

import argparse
import signal
import threading
import time

import mujoco

from common.errors import DeviceError
from common.frames import BASE
from rig_simulation.command_line import finite, port, positive
from rig_simulation.control_port import ControlClient

HOST = "127.0.0.1"
TIMEOUT_S = 2.0
RETRY_S = 0.2
PATIENCE_S = 20.0
"""Longest time without an answer of a world that has not ended."""
ABOVE_TABLE_M = 0.25
NICENESS = 10
"""Whoever looks must not take the processor from those who work."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds what both programs take."""
    add = parser.add_argument
    add("--port", type=port, default=30021, help="control port of the world")
    add("--rate", type=positive, default=20.0, help="pictures a second")
    add("--wait", type=positive, default=60.0, metavar="S", help="longest time to wait for the world")
    add(
        "--view",
        type=finite,
        nargs=3,
        default=(150.0, -20.0, 1.6),
        metavar=("AZIMUTH", "ELEVATION", "DISTANCE"),
        help="from where it looks: degrees, degrees, m",
    )


def stop_when_interrupted() -> threading.Event:
    """Returns an event that Ctrl-C and SIGTERM set."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop


def wait_for_world(client: ControlClient, longest: float, stop: threading.Event) -> None:
    """Waits until the world answers, or `stop` is set.

    Raises:
        DeviceError: it does not within so many seconds.
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


def aim(camera: mujoco.MjvCamera, view: tuple[float, float, float], data: mujoco.MjData) -> None:
    """Lets a free camera look above the table, from where `view` says: azimuth, elevation [deg], distance [m]."""
    camera.azimuth, camera.elevation, camera.distance = view
    table, base = data.body("table").xpos, data.body(BASE).xpos
    camera.lookat[:] = (*(0.8 * table[:2] + 0.2 * base[:2]), table[2] + ABOVE_TABLE_M)

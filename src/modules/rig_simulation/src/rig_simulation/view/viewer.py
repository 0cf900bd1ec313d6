"""The program `viewer.py`: the simulated world in MuJoCo's own window, in a process apart, so that it keeps its time.

What is dragged or pressed in the window has no effect on the world.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading

from common.errors import DeviceError
from rig_simulation.camera.world_copy import WorldCopy
from rig_simulation.command_line import parse_options
from rig_simulation.control_port import ControlClient
from rig_simulation.view.following import (
    HOST,
    NICENESS,
    TIMEOUT_S,
    add_options,
    aim,
    stop_when_interrupted,
    wait_for_world,
)
from rig_simulation.view.forces import arrows
from rig_simulation.view.scene_forces import add_arrows

NAME = "viewer"


def main(arguments: list[str] | None = None) -> int:
    """Shows the world until the window is closed, it is interrupted, or the world ends; returns the exit code."""
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="Shows the simulated world in a window.")
    add_options(parser)
    options = parse_options(parser, arguments)
    stop = stop_when_interrupted()
    if not os.environ.get("DISPLAY"):
        print(f"{NAME}: There is no screen (DISPLAY is not set).", file=sys.stderr)
        return 1
    os.nice(NICENESS)
    try:
        with ControlClient(HOST, options.port, TIMEOUT_S) as client:
            wait_for_world(client, options.wait, stop)
            _show(client, options, stop)
    except DeviceError as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1
    return 0


def _show(client: ControlClient, options: argparse.Namespace, stop: threading.Event) -> None:
    """Shows the world in a window, and in a new one after a change of scene.

    Raises:
        DeviceError: the world does not answer any more.
    """
    from mujoco import viewer  # opens the screen

    world, window = WorldCopy(client), None
    try:
        while not stop.wait(1.0 / options.rate) and (window is None or window.is_running()):
            is_new = world.follow()
            contacts = client.ask("contacts")["contacts"]
            if is_new:
                if window is not None:
                    window.close()
                window = viewer.launch_passive(world.model, world.data, show_left_ui=False, show_right_ui=False)
            assert window is not None  # the first state is of a new model
            with window.lock():
                if is_new:
                    aim(window.cam, tuple(options.view), world.data)
                window.user_scn.ngeom = 0
                add_arrows(window.user_scn, arrows(contacts))
            window.sync()
    finally:
        if window is not None:
            window.close()

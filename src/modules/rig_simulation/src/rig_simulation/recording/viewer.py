"""The program `viewer.py`: the simulated world in MuJoCo's viewer, in a process of its own that does not slow it down.
Input in the window has no effect on the world."""

from __future__ import annotations

import argparse
import os
import threading
import warnings
from typing import Any

from common import clock
from common.command_line import failed, parse_options
from common.errors import DeviceError
from common.screen import no_x_server
from rig_simulation.control_port import ControlClient, PortClosedError
from rig_simulation.recording import display
from rig_simulation.world.model import WorldCopy

NAME = "viewer"


def main(arguments: list[str] | None = None) -> int:
    """Shows the world until the window is closed, it is interrupted, or the world stops; returns the exit code."""
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="Shows the simulated world in a window.")
    display.add_options(parser)
    options = parse_options(parser, arguments)
    stop = display.stop_when_interrupted()
    os.nice(display.NICENESS)
    try:
        _check_screen()
        with ControlClient(display.HOST, options.port, display.TIMEOUT_S) as client:
            display.wait_for_world(client, options.wait, stop)
            _show(client, options, stop)
    except DeviceError as error:
        return failed(NAME, error)
    return 0


def _check_screen() -> None:
    """Opens the connection to the screen, whose absence the window's thread could not report as a DeviceError."""
    import glfw  # with mujoco

    if fault := no_x_server():
        raise DeviceError(f"The viewer is not opened: {fault}. Start without it, or set DISPLAY.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error below says the same
        opened = glfw.init()
    if not opened:
        screen = os.environ["DISPLAY"]
        raise DeviceError(f"Cannot open the screen {screen} (DISPLAY). Allow access, or start without the viewer.")


def _show(client: ControlClient, options: argparse.Namespace, stop: clock.Event) -> None:
    """Shows the world in a window, a new one after a change of the scene, until it stops; DeviceError if it hangs."""
    world, window, answered = WorldCopy(client), None, clock.monotonic()
    try:
        while not stop.wait(1.0 / options.rate) and (window is None or window.is_open):
            try:
                pairs = display.pair_forces(client.ask("contacts")["contacts"])
                is_new = world.follow()
            except PortClosedError:
                print(f"{NAME}: The world has stopped.", flush=True)
                break
            except DeviceError:
                if clock.monotonic() - answered > display.PATIENCE_S:
                    raise
                continue
            answered = clock.monotonic()
            if is_new:
                if window is not None:
                    window.close()
                window = ViewerWindow(world, tuple(options.view))
            assert window is not None  # the first state is of a new model
            window.show(display.arrows(pairs))
    finally:
        if window is not None:
            window.close()


class ViewerWindow:
    """MuJoCo's passive viewer of a copy of the world; `view`: see display.point_camera."""

    def __init__(self, world: WorldCopy, view: tuple[float, float, float]) -> None:
        from mujoco import viewer  # opens the screen

        before = threading.enumerate()
        self._handle: Any = viewer.launch_passive(world.model, world.data, show_left_ui=False, show_right_ui=False)
        self._threads = [thread for thread in threading.enumerate() if thread not in before]
        with self._handle.lock():
            display.point_camera(self._handle.cam, view, world.data)

    @property
    def is_open(self) -> bool:
        return self._handle.is_running()

    def show(self, forces: list) -> None:
        with self._handle.lock():
            self._handle.user_scn.ngeom = 0
            display.add_arrows(self._handle.user_scn, forces)
        self._handle.sync()

    def close(self) -> None:
        """Closes it and waits for its drawing thread, which would crash the program at its exit."""
        closing_s = 30.0
        self._handle.close()
        for thread in self._threads:
            thread.join(closing_s)

"""The program `record.py`: films the simulated world in a process of its own, without a display.

It follows the world through its control port and does not slow it down; the film has the world's time.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import mujoco
import numpy as np

from common import clock
from common.command_line import failed, parse_options, positive
from common.errors import DeviceError, RigError
from rig_simulation.control_port import ControlClient, PortClosedError
from rig_simulation.recording import display
from rig_simulation.recording.films import ContactSheet, Mp4, film_for, with_lines
from rig_simulation.world.model import WorldCopy

NAME = "record"


def main(arguments: list[str] | None = None) -> int:
    """Films until it is interrupted, the world stops, or the time is over; returns the exit code."""
    options = _options(arguments)
    stop = display.stop_when_interrupted()
    os.nice(display.NICENESS)
    try:
        films = [film_for(path, options.rate) for path in options.files]
        with ControlClient(display.HOST, options.port, display.TIMEOUT_S) as client:
            display.wait_for_world(client, options.wait, stop)
            images = record(client, films, options, stop)
    except RigError as error:
        return failed(NAME, error)
    print(f"{NAME}: {images} images in {', '.join(map(str, options.files))}", flush=True)
    return 0


def record(
    client: ControlClient, films: list[Mp4 | ContactSheet], options: argparse.Namespace, stop: clock.Event
) -> int:
    """Films the world, closes the films; returns the number of images, or raises RigError if the film stops early."""
    count, start, due = 0, None, clock.monotonic()
    view = FilmView(client, tuple(options.size), tuple(options.view))
    try:
        while not stop.wait(max(0.0, due - clock.monotonic())):
            due = max(due + 1.0 / options.rate, clock.monotonic())
            if not _follow(view, stop):
                break
            image = view.image()
            start = view.time if start is None else start
            if options.duration is not None and view.time - start > options.duration:
                break
            for film in films:
                film.add(image, view.time)
            count += 1
    finally:
        view.close()
        for film in films:
            film.close()
    return count


def _follow(view: FilmView, stop: clock.Event) -> bool:
    """Lets the view follow; returns False once the world stopped or `stop` is set, DeviceError if the world hangs."""
    deadline = clock.monotonic() + display.PATIENCE_S
    while not stop.is_set():
        try:
            view.follow()
            return True
        except PortClosedError:
            return False
        except DeviceError as error:
            if clock.monotonic() > deadline:
                raise DeviceError(f"The film stops at {view.time:.1f} s of the world: {error}") from None
        stop.wait(display.RETRY_S)
    return False


class FilmView:
    """Renders a copy of the world in images of width and height `size` [px]; `time`: of its last state [s]."""

    def __init__(self, client: ControlClient, size: tuple[int, int], view: tuple[float, float, float]) -> None:
        self._client = client
        self._world = WorldCopy(client)
        self._size, self._view = size, view
        self._camera = mujoco.MjvCamera()
        self._renderer: mujoco.Renderer | None = None
        self._contacts: list[dict] = []
        self._is_new, self.time = False, 0.0

    def follow(self) -> None:
        self._is_new |= self._world.follow()
        self._contacts = self._client.ask("contacts")["contacts"]
        self.time = self._client.ask("state")["time"]

    def image(self) -> np.ndarray:
        """Returns an image of the last state, shape (height, width, 3), RGB."""
        shown_forces = 6
        if self._is_new:
            self._attach()
            self._is_new = False
        assert self._renderer is not None  # the first state is of a new model
        self._renderer.update_scene(self._world.data, self._camera)
        pairs = display.pair_forces(self._contacts)
        display.add_arrows(self._renderer.scene, display.arrows(pairs))
        grasp = [pair for pair in pairs if pair.by_robot][:shown_forces]
        lines = [f"{self.time:.1f} s"]
        for pair in grasp:
            first, second = map(display.short, pair.bodies)
            lines.append(f"{second} on {first}: {pair.newtons:.1f} N")
        return with_lines(self._renderer.render(), lines)

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _attach(self) -> None:
        max_geoms = 5000
        self.close()
        model, (width, height) = self._world.model, self._size
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        try:
            self._renderer = mujoco.Renderer(model, height, width, max_geom=max_geoms)
        except (RuntimeError, AttributeError, ImportError, mujoco.FatalError) as error:
            raise DeviceError(f"Cannot render without a display: {error}. Install libegl1 and libegl-mesa0.") from None
        display.point_camera(self._camera, self._view, self._world.data)


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="Films the simulated world.")
    display.add_options(parser)
    add = parser.add_argument
    add("files", type=Path, nargs="+", metavar="FILE", help="a film (.mp4) or a contact sheet (.png)")
    add("--size", type=int, nargs=2, default=(960, 540), metavar=("WIDTH", "HEIGHT"), help="of an image, px")
    add("--duration", type=positive, metavar="S", help="seconds of the world; default: until it is interrupted")
    return parse_options(parser, arguments)

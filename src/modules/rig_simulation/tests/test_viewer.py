"""The program viewer.py on a screen of its own: what it shows, and how it ends."""

from __future__ import annotations

import mmap
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from common import clock
from rig_simulation.control_port import ControlClient
from rig_simulation.recording import viewer as viewer_program
from rig_simulation.recording.display import OF_OTHERS

SCRIPTS = Path(__file__).parents[1] / "scripts"
LONG_S = 60.0
"""Longest wait; the machine may be busy."""
PORTS = [text for name in ("", "control-", "hand-", "hand-control-", "world-") for text in (f"--{name}port", "0")]

needs_screen = pytest.mark.skipif(not shutil.which("Xvfb"), reason="the package xvfb is not installed")


class Screen:
    """A virtual screen."""

    def __init__(self, number, file):
        self.display = f":{number}"
        self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    def picture(self):
        """Returns what is on it, shape (height, width, 3), RGB (XWDFile.h: 25 numbers, the colour map, the pixels)."""
        header = struct.unpack(">25I", self._memory[:100])
        start, width, height, line = header[0] + 12 * header[19], header[4], header[5], header[12]
        pixels = np.frombuffer(self._memory, np.uint8, height * line, start).reshape(height, line)
        return pixels[:, : 4 * width].reshape(height, width, 4)[..., 2::-1].copy()

    def shows(self, colour):
        """Whether many pixels have this colour, RGB 0 to 1, in some light."""
        picture = self.picture().reshape(-1, 3).astype(float)
        bright = picture[picture.max(axis=1) > 60.0]
        of_colour = bright / bright.max(axis=1, keepdims=True)
        wanted = np.asarray(colour[:3]) / max(colour[:3])
        return np.sum(np.linalg.norm(of_colour - wanted, axis=1) < 0.06) > 100


@pytest.fixture
def screen(processes, tmp_path, wait_until):
    # Small, as the processor draws it.
    arguments = ("-screen", "0", "800x600x24", "-fbdir", str(tmp_path), "-noreset", "-nolisten", "tcp")
    server = processes.start("Xvfb", "-displayfd", "1", *arguments)
    number = wait_until(lambda: re.search(r"^(\d+)$", server.log_path.read_text(), re.M), LONG_S, "the screen")
    with open(tmp_path / "Xvfb_screen0", "rb") as file:
        return Screen(number[1], file)


@pytest.fixture
def world(processes, wait_until):
    """A running world with a cup in it, and the number of its control port."""
    process = processes.start(sys.executable, str(SCRIPTS / "world.py"), *PORTS)
    wait_until(lambda: "world: scene" in process.log_path.read_text(), LONG_S, "the world")
    return process, int(process.log_path.read_text().strip().rsplit(":", 1)[1])


@pytest.fixture
def start(processes, screen, world, wait_until):
    """Starts the program, and waits until it shows the force of the table on the cup."""

    def start():
        view = ("--view", "150", "-20", "0.6")
        command = (sys.executable, str(SCRIPTS / "viewer.py"), "--port", str(world[1]), *view)
        process = processes.start(*command, env={"DISPLAY": screen.display, "MUJOCO_GL": "glfw"})
        wait_until(lambda: screen.shows(OF_OTHERS), LONG_S, "the arrow of the cup's weight")
        return process

    return start


@pytest.fixture
def viewer(start):
    return start()


def ends(process):
    """Returns the exit code, and what the program printed."""
    return process.wait(LONG_S), process.log_path.read_text()


@pytest.mark.long
@needs_screen
def test_it_shows_the_world_and_its_forces_follows_a_change_of_scene_and_ends_when_it_is_terminated(
    viewer, screen, world, wait_until
):
    with ControlClient("127.0.0.1", world[1], LONG_S) as control:
        control.ask("set_scene", scene="empty")
        wait_until(lambda: not screen.shows(OF_OTHERS), LONG_S, "the empty scene")
        control.ask("set_scene", scene="cup")
        wait_until(lambda: screen.shows(OF_OTHERS), LONG_S, "the cup again")
    viewer.send_signal(signal.SIGTERM)
    assert ends(viewer) == (0, "")


@pytest.mark.long
@needs_screen
@pytest.mark.skipif(not shutil.which("xdotool"), reason="the package xdotool is not installed")
def test_it_ends_when_its_window_is_closed_and_another_one_with_the_world(viewer, start, screen, world, processes):
    quit_window = ("xdotool", "search", "--onlyvisible", "--name", "MuJoCo", "windowfocus", "--sync", "key", "ctrl+q")
    # Its exit code says nothing: it fails if the window is gone before it releases the keys.
    subprocess.run(quit_window, env={**os.environ, "DISPLAY": screen.display}, timeout=LONG_S, check=False)
    assert ends(viewer) == (0, "")
    another = start()
    processes.end(world[0])
    assert ends(another) == (0, "viewer: The world has stopped.\n")


@pytest.mark.parametrize(
    ("display", "sentence"),
    [(None, "neither DISPLAY nor"), (":98765", ":98765")],
)
def test_without_a_screen_it_says_so(monkeypatch, capsys, display, sentence):
    monkeypatch.setattr(viewer_program.display, "stop_when_interrupted", clock.Event)
    monkeypatch.setattr(viewer_program.os, "nice", lambda _: None)
    if display:
        monkeypatch.setenv("DISPLAY", display)
    assert viewer_program.main([]) == 1
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1

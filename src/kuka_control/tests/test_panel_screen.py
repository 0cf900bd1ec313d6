"""The program gui.py on a screen of its own, clicked at the widgets' positions, its colours read from the screen."""

from __future__ import annotations

import mmap
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rig_msgs.srv")
from ctypes import CDLL, Structure, Union, byref, c_char_p, c_int, c_long, c_ulong, c_void_p

from kuka_control.gui.panel import ControlPanel

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.real,
    pytest.mark.skipif(
        not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="the packages xvfb and xdotool are not installed"
    ),
]

FAKE = str(Path(__file__).with_name("fake_controller.py"))
TITLE = "Leap Rig: control"
LONG_S = 30.0
"""Longest wait; the machine may be busy."""
ASK_S = 0.2
"""Between two questions of xdotool, each of which starts a program."""

GREEN, GREY, LOCKED, RED = (0x2E, 0x9E, 0x44), (0xE4, 0xE7, 0xEB), (0xF1, 0xF3, 0xF5), (0xC6, 0x28, 0x28)
NORMAL, WARNING = (0xFF, 0xFF, 0xFF), (0xFF, 0xF3, 0xD6)


class Screen:
    """A virtual screen, with the panel in its upper left corner."""

    def __init__(self, folder, number, wait_until):
        self.display = f":{number}"
        self._wait_until = wait_until
        self._twin = None
        with open(folder / "Xvfb_screen0", "rb") as file:
            self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    def xdotool(self, *command):
        done = subprocess.run(
            ["xdotool", *map(str, command)],
            env={**os.environ, "DISPLAY": self.display},
            capture_output=True, text=True, timeout=LONG_S,
        )  # fmt: skip
        return done.stdout

    def wait_for_panel(self):
        """Waits for the window and makes a hidden twin of the panel, which knows where the widgets are."""
        shown = ("search", "--onlyvisible", "--name", TITLE)
        self.window = self._wait_until(lambda: self.xdotool(*shown).split(), LONG_S, "the window", ASK_S)[0]
        self._twin = ControlPanel()
        self._twin.show()
        self._follow_window()
        self.wait_for("emergency", RED)

    def _follow_window(self):
        """Puts the twin where the window is now: Qt may still move and resize one that is already seen."""
        place = dict(re.findall(r"(\w+)=(-?\d+)", self.xdotool("getwindowgeometry", "--shell", self.window)))
        if place:  # the window may just have gone
            self.origin = int(place["X"]), int(place["Y"])
            self._twin.resize(int(place["WIDTH"]), int(place["HEIGHT"]))

    def place(self, name):
        """Returns a point near the upper left corner of a widget, where its background is [px]."""
        from python_qt_binding.QtCore import QPoint

        point = getattr(self._twin, name).mapTo(self._twin, QPoint(10, 10))
        return self.origin[0] + point.x(), self.origin[1] + point.y()

    def click(self, name):
        self.xdotool("mousemove", *self.place(name), "click", 1, "mousemove", 799, 799)

    def click_until(self, name, colour):
        """Clicks until the widget has a colour: a controller that pauses lets a request go."""

        def done():
            self._follow_window()
            return self.colour(name) == colour or self.click(name)

        self._wait_until(done, LONG_S, f"{name} in {colour}", 1.0)

    def key(self, name):
        self.xdotool("windowfocus", "--sync", self.window, "key", name)

    def colour(self, name):
        """Returns the colour of a widget as it is on the screen (XWDFile.h: 25 numbers, the colour map, the pixels)."""
        header = struct.unpack(">25I", self._memory[:100])
        start, bits, line = header[0] + 12 * header[19], header[11], header[12]
        x, y = self.place(name)
        blue, green, red = self._memory[start + y * line + x * bits // 8 :][:3]
        return red, green, blue

    def wait_for(self, name, *colours):
        followed = 0.0

        def seen():
            nonlocal followed
            if self.colour(name) in colours:
                return True
            if time.monotonic() > followed + ASK_S:
                self._follow_window()
                followed = time.monotonic()
            return False

        try:
            self._wait_until(seen, LONG_S, f"{name} in one of {colours}")
        except pytest.fail.Exception as failure:
            pytest.fail(f"{failure.msg}; it is {self.colour(name)} at {self.place(name)}")


@pytest.fixture
def screen(application, processes, tmp_path, wait_until):
    size = ("-screen", "0", "800x800x24", "-fbdir", str(tmp_path))
    server = processes.start("Xvfb", "-displayfd", "1", *size, "-noreset", "-nolisten", "tcp")
    number = wait_until(lambda: re.search(r"^(\d+)$", server.log_path.read_text(), re.M), LONG_S, "the screen")
    return Screen(tmp_path, number[1], wait_until)


@pytest.fixture
def panel(screen, processes):
    """Starts the program on the screen."""

    def start(**env):
        env = {"DISPLAY": screen.display, "QT_QPA_PLATFORM": "xcb", **env}
        process = processes.start("rosrun", "kuka_control", "gui.py", env=env)
        screen.wait_for_panel()
        return process

    return start


def assert_ends_well(process):
    assert process.wait(LONG_S) == 0, process.log_path.read_text()
    assert "Traceback" not in process.log_path.read_text(), process.log_path.read_text()


def test_a_person_clicks_presses_a_key_and_closes_the_window(ros, screen, panel, processes):
    shown = panel()
    screen.wait_for("control", LOCKED)
    controller = processes.start(sys.executable, FAKE)
    screen.wait_for("control", GREY)
    screen.click_until("control", GREEN)  # leaves the focus on Emergency Stop
    screen.key("space")
    assert controller.wait(LONG_S) in (2, -signal.SIGKILL)  # one that does not end in time is killed
    screen.wait_for("control", LOCKED)
    ask_to_close(screen.display, int(screen.window))
    assert_ends_well(shown)


def ask_to_close(display, window):
    """Sends what a window manager sends when its close button is clicked (ICCCM 4.2.8.1)."""

    class ClientMessage(Structure):
        _fields_ = (
            ("type", c_int), ("serial", c_ulong), ("send_event", c_int), ("display", c_void_p), ("window", c_ulong),
            ("message_type", c_ulong), ("format", c_int), ("data", c_long * 5),
        )  # fmt: skip

    class Event(Union):
        _fields_ = (("client", ClientMessage), ("pad", c_long * 24))

    x11 = CDLL("libX11.so.6")
    x11.XOpenDisplay.restype, x11.XOpenDisplay.argtypes = c_void_p, [c_char_p]
    x11.XInternAtom.restype, x11.XInternAtom.argtypes = c_ulong, [c_void_p, c_char_p, c_int]
    x11.XSendEvent.argtypes = [c_void_p, c_ulong, c_int, c_long, c_void_p]
    x11.XCloseDisplay.argtypes = [c_void_p]
    connection = x11.XOpenDisplay(display.encode())
    event = Event()
    event.client.type, event.client.window, event.client.format = 33, window, 32
    event.client.message_type = x11.XInternAtom(connection, b"WM_PROTOCOLS", 0)
    event.client.data[0] = x11.XInternAtom(connection, b"WM_DELETE_WINDOW", 0)
    x11.XSendEvent(connection, window, 0, 0, byref(event))
    x11.XCloseDisplay(connection)

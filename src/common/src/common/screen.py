"""Whether windows can be shown. Qt ends a process that it finds no screen for, so a program asks before."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path

from common import clock
from common.errors import DeviceError

PANEL_PX = (560, 780)  # wanted size of the control panel, for one arm
TITLE_PX, EDGE_PX = 32, 4  # of a window's frame
X11 = ("", "xcb")  # platforms of Qt
WITHOUT = ("offscreen", "minimal")  # those that need nothing, and show nothing
TRIAL = """
try:
    from python_qt_binding.QtWidgets import QApplication
except ImportError:  # RViz needs none
    raise SystemExit(0)
QApplication(["trial"])
"""


def check_screen(what: str, cure: str = "") -> None:
    """Raises DeviceError if no window can be shown; `what` is then not opened, and `cure` a sentence."""
    if fault := no_window():
        raise DeviceError(f"{what} is not opened: {fault}. {cure}".rstrip())


def no_window() -> str:
    """Returns why Qt cannot open a window, a part of a sentence; empty if it can, maybe one that nobody sees."""
    return "" if _platform() in WITHOUT else no_screen()


def no_screen() -> str:
    """Returns why nobody would see a window of Qt, a part of a sentence; empty if there is a screen."""
    trial_s = 10.0  # longest wait for a Python that opens one
    if sys.platform != "linux":
        return ""
    if _platform() in (*X11, *WITHOUT):
        fault = no_x_server()
        if not (fault and os.environ.get("WAYLAND_DISPLAY")):
            return fault  # by X11 Qt opens a window on Wayland, too
    names = ("QT_QPA_PLATFORM", "WAYLAND_DISPLAY", "DISPLAY")
    given = ", ".join(f"{name}={os.environ[name]}" for name in names if os.environ.get(name))
    try:
        trial = subprocess.run([sys.executable, "-c", TRIAL], timeout=trial_s, capture_output=True, check=False)
    except subprocess.TimeoutExpired:
        return f"the screen does not answer ({given})"
    said = trial.stderr.decode(errors="replace").strip().partition("\n")[0]
    return f"Qt finds no screen with {given} ({said.rpartition('qt.qpa.')[2]})" if trial.returncode else ""


def has_graphics_card() -> bool:
    """Returns whether a graphics card draws; else a processor does, slowly."""
    if os.environ.get("LIBGL_ALWAYS_SOFTWARE", "0").lower() in ("1", "true", "yes"):
        return False
    return any(Path("/dev/dri").glob("renderD*")) or Path("/dev/nvidiactl").exists()


def panel_area(left: int, top: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Returns left, top, width and height of the control panel within this free area of the screen [px]: at its right
    edge, inside the frame that the window gets."""
    wide = min(PANEL_PX[0], width - 2 * EDGE_PX)
    high = min(PANEL_PX[1], height - TITLE_PX - EDGE_PX)
    return left + width - wide - EDGE_PX, top + TITLE_PX, wide, high


def view_area(left: int, top: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Returns the same of a window beside the control panel."""
    beside = panel_area(left, top, width, height)[0] - EDGE_PX - left
    return left + EDGE_PX, top + TITLE_PX, beside - 2 * EDGE_PX, height - TITLE_PX - EDGE_PX


def _platform() -> str:
    return os.environ.get("QT_QPA_PLATFORM", "").partition(":")[0]


def no_x_server() -> str:
    """Returns why a window cannot be shown on an X server, a part of a sentence; empty if it can."""
    answer_s = 3.0  # longest wait for a screen
    name = os.environ.get("DISPLAY")
    if not name:
        return "there is no screen, as neither DISPLAY nor WAYLAND_DISPLAY is set"
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:  # Qt will say what is missing
        return ""
    x11.XOpenDisplay.restype = ctypes.c_void_p
    opened: list[int | None] = []
    # Beside this thread, as the library waits for ever for a server that is silent.
    asks = clock.Thread(target=lambda: opened.append(x11.XOpenDisplay(None)), name="screen", daemon=True)
    asks.start()
    asks.join(answer_s)
    if not any(opened):
        return f"the screen {name} (DISPLAY) does not answer"
    x11.XCloseDisplay(ctypes.c_void_p(opened[0]))
    return ""

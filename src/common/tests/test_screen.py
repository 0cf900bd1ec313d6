"""Why no window can be shown, by what the environment says."""

from __future__ import annotations

from pathlib import Path

import pytest

from common import screen
from common.errors import DeviceError

NAMES = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")


@pytest.mark.parametrize(
    ("environment", "said", "sure"),
    [
        ({}, "neither DISPLAY nor WAYLAND_DISPLAY is set", True),
        ({"DISPLAY": ""}, "neither DISPLAY nor WAYLAND_DISPLAY is set", True),
        ({"DISPLAY": ":98765"}, "the screen :98765 (DISPLAY) does not answer", True),
        ({"DISPLAY": "nonsense"}, "the screen nonsense (DISPLAY) does not answer", True),
        ({"DISPLAY": ":98765", "QT_QPA_PLATFORM": "xcb"}, "the screen :98765 (DISPLAY) does not answer", True),
        ({"QT_QPA_PLATFORM": "offscreen"}, "neither DISPLAY nor", False),
        ({"QT_QPA_PLATFORM": "offscreen:size=1"}, "neither DISPLAY nor", False),
        ({"QT_QPA_PLATFORM": "minimal", "DISPLAY": ":98765"}, "the screen :98765", False),
    ],
)
def test_what_is_wrong_with_the_screen_is_said(monkeypatch, environment, said, sure):
    """Where Qt draws into nothing there is no screen, but a window opens."""
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert said in screen.no_screen()
    assert screen.no_window() == (screen.no_screen() if sure else "")
    if sure:
        with pytest.raises(DeviceError, match="The view is not opened: .* Use another."):
            screen.check_screen("The view", "Use another.")
    else:
        screen.check_screen("The view")


def test_on_wayland_a_screen_of_x11_suffices(monkeypatch):
    """A trial of Qt takes seconds while a rig starts."""
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    monkeypatch.delenv("QT_QPA_PLATFORM", raising=False)
    monkeypatch.setattr(screen, "no_x_server", lambda: "")
    monkeypatch.setattr(screen.subprocess, "run", None)
    assert screen.no_screen() == ""


@pytest.mark.real
def test_without_pythons_qt_nothing_is_known_of_a_screen(monkeypatch, tmp_path):
    """RViz needs none."""
    (tmp_path / "python_qt_binding.py").write_text("raise ImportError")
    for name, value in {"WAYLAND_DISPLAY": "nosuch", "DISPLAY": "", "PYTHONPATH": str(tmp_path)}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("QT_QPA_PLATFORM", raising=False)
    assert screen.no_screen() == ""


@pytest.mark.real
@pytest.mark.parametrize(
    ("environment", "code", "said"),
    [({"QT_QPA_PLATFORM": "", "DISPLAY": ":98765"}, 1, "RViz is not opened: the screen :98765"),
     ({"QT_QPA_PLATFORM": "offscreen"}, 0, "started")],
)  # fmt: skip
def test_a_launch_file_opens_rviz_where_there_is_a_screen(processes, environment, code, said):
    script = Path(screen.__file__).parents[2] / "shell" / "with_screen.sh"
    started = processes.start(str(script), "echo", "started", env={"WAYLAND_DISPLAY": "", **environment})
    assert started.wait(30.0) == code and started.log_path.read_text().startswith(said)


@pytest.mark.real
@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({"QT_QPA_PLATFORM": "nonsense", "DISPLAY": ":98765"}, "QT_QPA_PLATFORM=nonsense"),
        ({"WAYLAND_DISPLAY": "nosuch"}, "WAYLAND_DISPLAY=nosuch"),
    ],
)
def test_qt_is_asked_for_other_platforms(monkeypatch, environment, said):
    pytest.importorskip("python_qt_binding")
    test_what_is_wrong_with_the_screen_is_said(monkeypatch, environment, said, True)

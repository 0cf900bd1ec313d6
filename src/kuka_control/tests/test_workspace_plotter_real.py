"""The workspace plotter as a person starts it."""

from __future__ import annotations

import os
import subprocess

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.long]
pytest.importorskip("matplotlib")


def test_saves_a_picture_without_a_display_and_says_both_figures(tmp_path):
    inherited = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    picture = tmp_path / "workspace.png"
    options = ("--save", str(picture), "--samples", "60", "--attitudes", "2", "--constrained", "40")
    command = ["rosrun", "kuka_control", "workspace_plotter.py", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env=inherited)
    assert done.returncode == 0, done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG\r\n\x1a\n") and picture.stat().st_size > 50_000
    assert "Reached with the tool straight down:" in done.stdout and "25 deg:" in done.stdout
    assert done.stderr == ""

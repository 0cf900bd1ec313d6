"""Starts RViz, fitted to the screen and to what draws; for with_screen.sh."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import Any

import rospkg
import yaml

from common.screen import has_graphics_card, no_window, view_area

SLOW_RATE_HZ = 10  # frames drawn by a processor: a fifth of one
PRESET, PLAIN = "-d", "--disable-anti-aliasing"  # arguments of RViz; without a card, smooth edges take half of the time


def fitted(preset: dict[str, Any], area: tuple[int, int, int, int] | None, card: bool) -> dict[str, Any]:
    """Returns a preset of RViz whose window stays in an area, left, top, width, height [px], if one is known, and
    which, without a graphics card, draws no more often than a processor bears."""
    made = dict(preset)
    if area is not None:
        left, top, width, height = area
        window = dict(preset.get("Window Geometry") or {})
        size = {"Width": min(window.get("Width", width), width), "Height": min(window.get("Height", height), height)}
        made["Window Geometry"] = {**window, **size, "X": left, "Y": top}
    if not card:
        manager = dict(preset.get("Visualization Manager") or {})
        options = dict(manager.get("Global Options") or {})
        options["Frame Rate"] = min(options.get("Frame Rate", SLOW_RATE_HZ), SLOW_RATE_HZ)
        made["Visualization Manager"] = {**manager, "Global Options": options}
    return made


def command(argv: list[str]) -> list[str]:
    """Returns the command that starts RViz so, with a fitted copy of its preset, read-only as the next start replaces
    it; if it cannot be written, the preset itself is used."""
    card = has_graphics_card()
    made = argv if card or PRESET not in argv else [*argv, PLAIN]
    with contextlib.suppress(ValueError, IndexError, OSError, yaml.YAMLError, TypeError, AttributeError):
        at = argv.index(PRESET) + 1
        preset = Path(argv[at])
        text = yaml.safe_dump(fitted(yaml.safe_load(preset.read_text()), _view_area(), card), sort_keys=False)
        copy = Path(rospkg.get_ros_home()) / "rviz" / preset.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.unlink(missing_ok=True)
        copy.write_text(text)
        copy.chmod(0o444)
        made = [*made[:at], str(copy), *made[at + 1 :]]
    return made


def _view_area() -> tuple[int, int, int, int] | None:
    """Returns the place beside the control panel, None where Python has no Qt."""
    try:
        from python_qt_binding.QtWidgets import QApplication
    except ImportError:
        return None
    application = QApplication(sys.argv[:1])
    return view_area(*application.primaryScreen().availableGeometry().getRect())


def main() -> None:
    """Replaces this process by RViz; without a screen exits with a sentence, as Qt would abort."""
    if fault := no_window():
        sys.exit(f"RViz is not opened: {fault}.")
    made = command(sys.argv[1:])
    os.execvp(made[0], made)

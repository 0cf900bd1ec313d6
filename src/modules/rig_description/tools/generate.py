#!/usr/bin/env python3
"""Writes the URDF files of this package anew from its tables. Run it after a change of the tables; a test compares."""

from __future__ import annotations

import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PACKAGE / "src"))

from rig_description.arms import ARMS, MEDIA_FLANGES  # noqa: E402
from rig_description.urdf import file_name, urdf  # noqa: E402


def main() -> None:
    """Writes every file."""
    for robot in ARMS:
        for flange in MEDIA_FLANGES:
            (PACKAGE / "urdf" / file_name(robot, flange)).write_text(urdf(robot, flange), encoding="utf-8")


if __name__ == "__main__":
    main()

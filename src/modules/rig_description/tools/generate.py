#!/usr/bin/env python3
"""Writes the URDF files of this package from its tables. A test compares them with what is checked in."""

from __future__ import annotations

import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(PACKAGE / "src"), str(PACKAGE.parent / "iiwa_kinematics" / "src")]

from rig_description.urdf import all_files  # noqa: E402

if __name__ == "__main__":
    for name, text in all_files().items():
        (PACKAGE / name).write_text(text, encoding="utf-8")

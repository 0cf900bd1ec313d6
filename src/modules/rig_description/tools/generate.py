#!/usr/bin/env python3
"""Writes the URDF files and meshes of this package from its tables. A test compares them with what is checked in."""

from __future__ import annotations

import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PACKAGE / "src"))

from rig_description.files import all_files  # noqa: E402


def main() -> None:
    """Writes every file."""
    for name, text in all_files().items():
        path = PACKAGE / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

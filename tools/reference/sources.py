"""Paths of the project's sources, for the generators."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference"


def on_path() -> None:
    """Makes the packages importable without a build."""
    for setup in sorted(ROOT.glob("src/**/setup.py")):
        folder = str(setup.parent / "src")
        if folder not in sys.path:
            sys.path.append(folder)


def package(path: Path) -> str:
    """Returns the name of a file's package, or of its top-level folder, e.g. tools."""
    return inside(path).split("/")[0]


def inside(path: Path) -> str:
    """Returns the path of a file from its package's name on, or from the root if it has no package."""
    for folder in path.parents:
        if (folder / "package.xml").is_file():
            return str(path.relative_to(folder.parent))
    return str(path.relative_to(ROOT))


def link(path: Path) -> str:
    """Returns a link from docs/reference to a file of the project."""
    return f"[{inside(path)}](../../{path.relative_to(ROOT)})"

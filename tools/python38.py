"""`python -m tools.python38`: what the source uses that Python 3.8, that of ROS Noetic, does not have. These are the
errors that mypy finds for that version and not for the newest one; other errors, as where types are not written down,
are the same for both. What has no type it cannot see: tests/test_architecture.py looks for that."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
OLD, NEWEST = "3.8", "3.13"
FOLDERS = ("src", "tools", "tests", "bench", "campaign", "fuzz", "golden", "simulated", "examples")
SKIPPED = {"scripts", "cfg"}  # a few lines each, and of the names of modules
FOUND = re.compile(r"(?P<place>.+?:\d+): error: .*\[(?P<kind>[\w-]+)\]")
MYPY = ["mypy", "--config-file=", "--namespace-packages", "--explicit-package-bases", "--check-untyped-defs"]
MYPY += ["--no-site-packages", "--no-error-summary"]


def source() -> list[Path]:
    """Returns the project's Python files."""
    found = (file for folder in FOLDERS for file in sorted(ROOT.glob(f"{folder}/**/*.py")))
    return [ROOT / "conftest.py", *(f for f in found if not SKIPPED & set(f.parts) and f.name != "setup.py")]


def missing_in_38(files: Sequence[Path]) -> list[str]:
    """Returns mypy's lines of what these files use and Python 3.8 lacks; RuntimeError: mypy could not read them."""
    old, newest = (_checked(version, files) for version in (OLD, NEWEST))
    known = _errors(newest).keys()
    return [line for error, line in _errors(old).items() if error not in known]


def _checked(version: str, files: Sequence[Path]) -> subprocess.Popen[str]:
    """Starts mypy, so that both run at once."""
    command = [sys.executable, "-m", *MYPY, "--python-version", version, "--cache-dir", f".mypy_cache/{version}"]
    paths = os.pathsep.join(str(setup.parent / "src") for setup in ROOT.glob("src/**/setup.py"))
    environment = {**os.environ, "MYPYPATH": paths}
    return subprocess.Popen([*command, *map(str, files)], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)


def _errors(running: subprocess.Popen[str]) -> dict[tuple[str, str], str]:
    said, _ = running.communicate()
    if running.returncode not in (0, 1):
        raise RuntimeError(f"mypy could not check for Python 3.8: {said}")
    return {(match["place"], match["kind"]): line for line in said.splitlines() if (match := FOUND.match(line))}


if __name__ == "__main__":
    lines = missing_in_38(source())
    print("\n".join(f"Not in Python 3.8: {line}" for line in lines), file=sys.stderr)
    sys.exit(bool(lines))

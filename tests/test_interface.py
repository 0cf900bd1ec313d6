"""The page of the running graph is as the demo's graph."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.rig]


def test_the_page_is_as_the_graph():
    done = subprocess.run(
        [sys.executable, "-m", "tools.interface", "--check"],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=250.0,
    )
    assert done.returncode == 0, f"python -m tools.interface writes the page anew\n{done.stderr}"

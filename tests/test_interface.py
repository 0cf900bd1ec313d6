"""The page of the ROS graph matches the running graphs."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tools.reference.sources import REFERENCE, ROOT

pytestmark = pytest.mark.ros


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("part", ["rig", "ptp", "vision"])
def test_the_page_is_as_the_graph(part):
    done = subprocess.run(
        [sys.executable, "-m", "tools.interface", "--check", "--part", part],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=500.0,
    )
    assert done.returncode == 0, f"python -m tools.interface writes the page anew\n{done.stderr}"


def test_the_page_has_no_other_parts():
    running_parts = pytest.importorskip("tools.running_parts")
    headings = [line[3:] for line in (REFERENCE / "interface.md").read_text().splitlines() if line.startswith("## ")]
    assert headings == [part.title for part in running_parts.PARTS.values()]

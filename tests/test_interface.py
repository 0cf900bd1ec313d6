"""The page of the ROS graph matches the running graphs."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tools.reference.sources import REFERENCE, ROOT

pytest.importorskip("rig_msgs.srv")
from leap_rig.ros.demo import launch_arguments, parse_arguments
from tools import interface, launched
from tools.running_parts import PARTS

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


def test_the_page_says_what_the_demo_starts():
    """The nodes of `make demo` are those that its launch file starts with its arguments, not those of roslaunch."""
    rig = PARTS["rig"]
    for command, words in {"HEADLESS=1": [], "HEADLESS=1 TRACKER=none": ["--tracker", "none"]}.items():
        arguments = launch_arguments(parse_arguments(words), screen=False)
        assert rig.started()[f"make demo {command}"] == launched.nodes("leap_rig", "demo.launch", *arguments)
    page = "".join(interface.ways(rig))
    rows = {line.split(" | ")[0].strip("| `"): line for line in page.splitlines() if line.startswith("| `")}
    assert "`leap_teleop`" in rows["make demo HEADLESS=1"] and "leap_kuka_node" not in rows["make demo HEADLESS=1"]
    apart = rows["roslaunch leap_rig demo.launch rviz:=false gui:=false"]
    assert all(f"`{name}`" in apart for name in ("leap_driver", "leap_kuka_node", "leap_hand_node", "leap_teleop"))
    assert f"{interface.RESUME_HZ:g} times a second at least" in interface.HEAD and not list(
        interface.ways(PARTS["vision"])
    )


def test_the_page_has_no_other_parts():
    running_parts = pytest.importorskip("tools.running_parts")
    headings = [line[3:] for line in (REFERENCE / "interface.md").read_text().splitlines() if line.startswith("## ")]
    assert headings == [part.title for part in running_parts.PARTS.values()]

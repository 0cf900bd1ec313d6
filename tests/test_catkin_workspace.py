"""A clone in a catkin workspace beside a foreign package is built, and its demo runs there."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from campaign.network.wire import in_own_network

pytestmark = [pytest.mark.real, pytest.mark.long]

ROOT = Path(__file__).parents[1]
ALONE = "import os, sys; from tools.own_network import bring_up; bring_up(); os.execv(sys.argv[1], sys.argv[1:])"


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("way", ["catkin_make", "catkin_build", "install"])
def test_the_demo_runs_in_somebody_elses_workspace(way, tmp_path, free_port):
    if way == "catkin_build" and not shutil.which("catkin", path="/usr/bin"):
        pytest.skip("Debian's package catkin-tools is not installed")
    # The Python packages are those of the terminal's Python, as after rosdep, so that nothing of the clone is needed.
    settings = {
        "HOME": str(tmp_path),
        "PATH": f"{ROOT}/.venv/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "ROS_MASTER_URI": f"http://localhost:{free_port()}",
    }
    command = [str(ROOT / "tools" / "catkin_workspace.sh"), way, str(tmp_path / "ws")]
    if subprocess.run(in_own_network(["true"]), capture_output=True).returncode == 0:  # other rigs use the same ports
        command = in_own_network([sys.executable, "-c", ALONE, *command])
    done = subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "ws" / "src").exists() is (way != "install")

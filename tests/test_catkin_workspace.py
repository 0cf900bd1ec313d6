"""A clone in a catkin workspace beside a foreign package is built, and its demo runs there."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

pytestmark = [pytest.mark.real, pytest.mark.long]

ROOT = Path(__file__).parents[1]


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
    done = subprocess.run(
        [ROOT / "tools" / "catkin_workspace.sh", way, tmp_path / "ws"], env=settings, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "ws" / "src").exists() is (way != "install")

"""kst, leap_motion and reflex install by pip without ROS and the rest of the tree, and their READMEs are right."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import websockets
import yaml

MODULES = Path(__file__).parents[1] / "src" / "modules"
SIMULATORS = MODULES / "rig_simulation" / "scripts"
PATIENCE = {
    "kst": ", timing=__import__('kst').KstTiming(reply=20.0, servo_reply=20.0)",
    "reflex": ", settings=__import__('reflex').HandSettings(silence_time=5.0)",
}
"""Added to the port in a README: this machine may be busy."""

ALONE = """
import sys
sys.path[:0] = {paths!r}
{block}
foreign = {{"common", "rospy", "pinocchio", "catkin_pkg"}} & set(sys.modules)
assert not foreign, foreign
"""


@pytest.fixture
def device(processes, wait_until):
    """Starts a simulated device; returns its port."""

    def start(program: str) -> str:
        command = (sys.executable, str(SIMULATORS / program), "--port", "0", "--control-port", "0")
        process = processes.start(*command, env={"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)})
        return wait_until(lambda: re.search(r"(\d+), control port", process.log_path.read_text()), 30.0, program)[1]

    return start


@pytest.mark.parametrize(
    ("name", "simulator", "port", "prints"),
    [
        pytest.param(
            "kst", "sunrise_controller.py", "30001", r"joints \[rad\]: \[ *0\. +0\.2 ", marks=pytest.mark.real
        ),
        pytest.param("leap_motion", "leapd.py", "6437", "Leap service", marks=pytest.mark.long),
        pytest.param("reflex", "reflex_hand.py", "11333", r"joints \[rad\]: \[2\.[45]", marks=pytest.mark.long),
    ],
)
def test_installs_alone_and_the_readme_runs(tmp_path, device, name, simulator, port, prints):
    source, target, without_catkin = (tmp_path / folder for folder in ("source", "target", "without_catkin"))
    shutil.copytree(
        MODULES / name, source, ignore=shutil.ignore_patterns("tests", "build", "*.egg-info", "__pycache__")
    )
    without_catkin.mkdir()
    (without_catkin / "catkin_pkg.py").write_text("raise ImportError('there is no catkin here')")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run(
        [*pip, "--target", target, source], check=True, env={**os.environ, "PYTHONPATH": str(without_catkin)}
    )
    assert not (target / name / "ros").exists()

    block = re.search(r"```python\n(.*?)```", (source / "README.md").read_text(), re.DOTALL)[1]
    assert port in block
    block = block.replace(port, f"{device(simulator)}{PATIENCE.get(name, '')}")
    packages = {str(Path(module.__file__).parents[1]) for module in (np, websockets, yaml)}
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-S", "-c", ALONE.format(paths=[str(target), *sorted(packages)], block=block)],
        env={**environment, "HOME": str(tmp_path)},
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stdout
    assert re.search(prints, done.stdout), done.stdout

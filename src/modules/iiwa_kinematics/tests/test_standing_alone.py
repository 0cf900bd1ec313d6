"""The package can be installed without ROS and without the rest of the tree, and its README is right."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.long

PACKAGE = Path(__file__).parents[1]


def test_installs_alone_and_the_readme_runs(tmp_path):
    source, target = tmp_path / "source", tmp_path / "target"
    shutil.copytree(PACKAGE, source, ignore=shutil.ignore_patterns("tests", "build", "*.egg-info", "__pycache__"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", target, source], check=True)

    block = re.search(r"```python\n(.*?)```", (PACKAGE / "README.md").read_text(), re.DOTALL)[1]
    numpy = Path(np.__file__).parents[1]
    alone = f"import sys; sys.path[:0] = [{str(target)!r}, {str(numpy)!r}]\n{block}"
    guard = "assert not {'rospy', 'common', 'pinocchio'} & set(sys.modules)\n"
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [sys.executable, "-S", "-c", alone + guard]
    output = subprocess.run(
        command, env=environment, cwd=tmp_path, check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    joints = [float(number) for number in re.findall(r"-?\d+\.?\d*", output)]
    assert len(joints) == 7 and joints[3] > -60.0, "the elbow opens where the flange goes up"

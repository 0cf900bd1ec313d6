"""kst, leap_motion, reflex and iiwa_kinematics install by pip without ROS and the rest of the tree, from their folders
and as wheels, and their READMEs are right.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import websockets
import yaml
from packaging.requirements import Requirement

from tests.test_manifests import names

ROOT = Path(__file__).parents[1]
MODULES = ROOT / "src" / "modules"
LIBRARIES = sorted(project.parent.name for project in MODULES.glob("*/pyproject.toml"))
SIMULATORS = MODULES / "rig_simulation" / "scripts"
DEVICES = {
    "kst": ("sunrise_controller.py", "30001"),
    "leap_motion": ("leapd.py", "6437"),
    "reflex": ("reflex_hand.py", "11333"),
}
"""The simulated device that a README's example connects to, and its port there."""
PRINTS = {
    "iiwa_kinematics": r"30\.56 .* -51\.97 .* 97\.47 ",
    "kst": r"joints \[rad\]: \[ *0\. +0\.2 ",
    "leap_motion": "Leap service",
    "reflex": r"joints \[rad\]: \[2\.[45]",
}
PATIENCE = {
    "kst": ", timing=__import__('kst').KstTiming(reply=20.0, servo_reply=20.0)",
    "reflex": ", settings=__import__('reflex').HandSettings(silence_time=5.0)",
}
"""Added to the port in a README: this machine may be busy."""
NAMES_ON_PYPI = {"cv2": "opencv-python-headless", "yaml": "pyyaml"}

ALONE = """
import sys
sys.path[:0] = {paths!r}
{block}
foreign = {{"common", "rospy", "pinocchio", "catkin_pkg"}} & set(sys.modules)
assert not foreign, foreign
"""
USER = """
from iiwa_kinematics import Kinematics, robot_model
from kst import KstClient
from leap_motion import LeapClient
from reflex import ReflexHand

reveal_type(Kinematics(robot_model("LBR7R800", "MF_elektrisch")).inverse)
reveal_type(KstClient.connect("127.0.0.1", 30001).start_joint_servo)
reveal_type(LeapClient("127.0.0.1", 6437).close)
reveal_type(ReflexHand("lo").calibrated)
wrong: str = robot_model("LBR7R800", "MF_elektrisch")
"""
REVEALED = [r"def \(.*\) -> iiwa_kinematics\.\w+\.IkResult", r"def \(.*\)", r"def \(\)", "builtins.bool"]


def imported(folder: Path, without: str) -> set[str]:
    """The packages on PyPI that modules outside the folder `without`, and outside ros, import."""
    files = [file for file in folder.rglob("*.py") if not {"ros", without} & set(file.parts)]
    found = {name for file in files for name in names(file)} - {folder.name, *getattr(sys, "stdlib_module_names", ())}
    return {NAMES_ON_PYPI.get(name, name) for name in found}


def required(lines: list[str]) -> set[str]:
    return {Requirement(line).name for line in lines}


@pytest.mark.skipif(sys.version_info < (3, 11), reason="this Python reads no toml files")
@pytest.mark.parametrize("name", LIBRARIES)
def test_pip_is_told_all_and_no_more(name):
    toml = pytest.importorskip("tomllib").loads((MODULES / name / "pyproject.toml").read_text())
    project, package = toml["project"], MODULES / name / "src" / name
    assert project["name"] == f"leap-rig-{name.replace('_', '-')}"
    assert (project["readme"], project["requires-python"]) == ("README.md", ">=3.8")
    assert {"version", "license"} == {*project["dynamic"]}, "they are those of package.xml"
    assert toml["tool"]["setuptools"] == {"package-data": {name: ["py.typed"]}} and (package / "py.typed").exists()
    assert [file for file in package.rglob("*") if file.is_file() and file.suffix not in (".py", ".pyc")] == [
        package / "py.typed"
    ], "nothing that is read as data would be left out of the wheel"
    assert (MODULES / name / "LICENSE").resolve() == ROOT / "LICENSE"
    assert (MODULES / name / "setup.py").read_bytes() == (MODULES / "kst" / "setup.py").read_bytes()
    assert required(project["dependencies"]) == imported(package, without="webcam")
    extra = required(project.get("optional-dependencies", {}).get("webcam", []))
    # ROS has the window's python_qt_binding.
    assert extra == imported(package, without="") - required(project["dependencies"]) - {"python_qt_binding"}


@pytest.fixture
def device(processes, wait_until):
    """Starts a simulated device; returns its port."""

    def start(program: str) -> str:
        command = (sys.executable, str(SIMULATORS / program), "--port", "0", "--control-port", "0")
        process = processes.start(*command, env={"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)})
        return wait_until(lambda: re.search(r"(\d+), control port", process.log_path.read_text()), 30.0, program)[1]

    return start


def example(name: str, device) -> str:
    """The first program in a library's README, which connects to a simulated device here."""
    block = re.search(r"```python\n(.*?)```", (MODULES / name / "README.md").read_text(), re.DOTALL)[1]
    if name not in DEVICES:
        return block
    simulator, port = DEVICES[name]
    assert port in block
    return block.replace(port, f"{device(simulator)}{PATIENCE.get(name, '')}")


@pytest.mark.real
def test_installs_alone_and_the_readme_runs(tmp_path, device):
    name = "kst"  # the wheels of all, below
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

    block = example(name, device)
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
    assert re.search(PRINTS[name], done.stdout), done.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """The wheels, made as `make wheels` makes them, by the name of the library."""
    folder = tmp_path_factory.mktemp("wheels")
    before = {*MODULES.rglob("*")}
    subprocess.run([ROOT / "tools" / "wheels.sh", folder], check=True)
    litter = {path for path in {*MODULES.rglob("*")} - before if "__pycache__" not in path.parts}
    assert not litter
    return {re.match(r"leap_rig_(\w+)-", path.name)[1]: path for path in folder.iterdir()}


@pytest.mark.long
@pytest.mark.real
def test_a_wheel_holds_the_library_and_what_is_said_of_it(wheels):
    assert sorted(wheels) == LIBRARIES
    for name, wheel in wheels.items():
        package = MODULES / name / "src"
        own = {str(file.relative_to(package)) for file in package.rglob("*") if file.suffix in (".py", ".typed")}
        with zipfile.ZipFile(wheel) as content:
            files = {file for file in content.namelist() if ".dist-info/" not in file}
            about = {Path(file).name: content.read(file).decode() for file in {*content.namelist()} - files}
        assert files == {file for file in own if f"{name}/ros/" not in file}
        assert about["LICENSE"] == (ROOT / "LICENSE").read_text()
        facts, readme = about["METADATA"].split("\n\n", 1)
        assert readme.strip() == (MODULES / name / "README.md").read_text().strip()
        version = re.search("<version>(.*)</version>", (MODULES / name / "package.xml").read_text())[1]
        assert {f"Version: {version}", "License: MIT", "Requires-Python: >=3.8"} <= {*facts.splitlines()}


@pytest.mark.long
@pytest.mark.real
@pytest.mark.parametrize("version", ["3.8", "3.11"])
def test_the_wheels_are_all_that_a_user_needs(version, wheels, tmp_path, device):
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    pythons = [*pyenv.glob(f"{version}.*/bin/python{version}"), shutil.which(f"python{version}")]
    if not pythons[0]:
        pytest.skip(f"no Python {version} was found on the PATH or under pyenv")
    python = tmp_path / "venv" / "bin" / "python"
    subprocess.run([pythons[0], "-m", "venv", tmp_path / "venv"], check=True)
    outside = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    subprocess.run([python, "-m", "pip", "install", "--quiet", *wheels.values()], check=True, env=outside, cwd=tmp_path)
    for name in LIBRARIES:
        command = [python, "-c", ALONE.format(paths=[], block=example(name, device))]
        bare = {"HOME": str(tmp_path), "PATH": os.defpath}
        done = subprocess.run(command, env=bare, cwd=tmp_path, capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stdout + done.stderr
        assert re.search(PRINTS[name], done.stdout), done.stdout
    (tmp_path / "user.py").write_text(USER)
    mypy = [sys.executable, "-m", "mypy", "--config-file=", "--python-executable", python, "user.py"]
    said = subprocess.run(mypy, env=outside, cwd=tmp_path, capture_output=True, text=True).stdout
    kinds = re.findall('note: Revealed type is "(.*)"', said)
    assert len(kinds) == len(REVEALED) and said.count(": error: ") == 1, said
    for pattern, kind in zip(REVEALED, kinds):
        assert re.fullmatch(pattern, kind), said
    assert re.search(r"user\.py:11: error: .*\[assignment\]", said), said

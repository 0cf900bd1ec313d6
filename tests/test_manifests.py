"""Each package.xml names what its package uses, no more, under keys that rosdep knows."""

from __future__ import annotations

import ast
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PACKAGES = {manifest.parent.name: manifest.parent for manifest in sorted(ROOT.glob("src/**/package.xml"))}
BUILD_FILES = {name: (folder / "CMakeLists.txt").read_text() for name, folder in PACKAGES.items()}
# Folders that are built from, or that only a clone needs.
MADE_OR_NOT_USED = {"src", "msg", "srv", "action", "env-hooks", "tests", "tools", "__pycache__"}
# The key of a module is its own name, but for these.
KEYS = {
    "aiortc": "leap-rig-aiortc",
    "apriltag": "leap-rig-apriltag",
    "av": "leap-rig-aiortc",  # which brings it
    "cv2": "leap-rig-opencv",
    "glfw": "leap-rig-mujoco",  # which brings it, as it does OpenGL
    "h5py": "leap-rig-h5py",
    "hppfcl": "leap-rig-pin",
    "matplotlib": "leap-rig-matplotlib",
    "mcap": "leap-rig-mcap",
    "mpl_toolkits": "leap-rig-matplotlib",
    "mujoco": "leap-rig-mujoco",
    "numpy": "leap-rig-numpy",
    "OpenGL": "leap-rig-mujoco",
    "openni": "leap-rig-openni",
    "pinocchio": "leap-rig-pin",
    "rospkg": "python3-rospkg",
    "ruckig": "leap-rig-ruckig",
    "torch": "leap-rig-torch",
    "tqdm": "python3-tqdm",
    "trimesh": "leap-rig-trimesh",
    "viser": "leap-rig-viser",
    "websockets": "leap-rig-websockets",
    "yaml": "python3-yaml",
    "zstandard": "leap-rig-mcap",
}
# rosdep installs none of these: a program says that it lacks them.
OPTIONAL = {"lerobot", "mediapipe", "openni2_launch", "qt_gui", "rclpy", "rosbags"}
# Programs that a package starts, libraries and messages that its modules load by name.
LOADED = {
    "leap_rig": {"sensor_msgs"},  # replay.py publishes recorded messages of it
    "leap_motion": {"openssl"},  # the certificate of the headset's page
    "rig_simulation": {"leap-rig-egl"},  # MuJoCo draws with it where there is no screen
    "vision": {"libopenni2-dev"},  # the name under which openni looks for the library
}
FINDS = {"_package_folders", "find_node", "get_path"}  # calls whose argument is the name of a package
# The versions of Debian 12 and Ubuntu 20.04 suffice, so that these are not of pip.
OF_THE_SYSTEM = {"pyyaml", "tqdm"}
OWN = yaml.safe_load((ROOT / "env" / "rosdep.yaml").read_text())
PUBLIC = {key for keys in yaml.safe_load((ROOT / "tests" / "rosdistro_keys.yaml").read_text()).values() for key in keys}


def names(file: Path) -> Iterator[str]:
    """The modules that a Python file imports, and the packages that it finds by name."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").split(".")[0]
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in FINDS:
            yield from (argument.value for argument in node.args[:1] if isinstance(argument, ast.Constant))


def used(folder: Path) -> set[str]:
    """The keys of what a package is made of, imports, launches and finds; its tests are left out."""
    found: set[str] = set()
    for file in folder.rglob("*"):
        if file.relative_to(folder).parts[0] in ("setup.py", "tests"):
            continue
        if file.suffix == ".py":
            found |= set(names(file))
        elif file.suffix == ".launch":
            text = file.read_text()
            found |= {*re.findall(r"\$\(find (\w+)\)", text), *re.findall(r'\bpkg="(\w+)"', text)}
        elif file.suffix in (".msg", ".srv", ".action"):
            found |= {"message_generation", "message_runtime", *re.findall(r"^(\w+)/\w+", file.read_text(), re.M)}
            found |= {"std_msgs"} if re.search("^Header ", file.read_text(), re.M) else set()
            found |= {"actionlib_msgs"} if file.suffix == ".action" else set()
    found -= {*getattr(sys, "stdlib_module_names", found), *OPTIONAL, folder.name}
    return {KEYS.get(name, name) for name in found} | LOADED.get(folder.name, set())


def named(folder: Path, *but: str) -> list[str]:
    manifest = ElementTree.parse(folder / "package.xml").getroot()
    return [entry.text or "" for entry in manifest if entry.tag.endswith("depend") and entry.tag not in but]


@pytest.mark.skipif(not hasattr(sys, "stdlib_module_names"), reason="this Python has no list of its own modules")
@pytest.mark.parametrize("name", PACKAGES)
def test_the_manifest_names_what_the_package_uses_and_no_more(name):
    stated = named(PACKAGES[name], "buildtool_depend", "test_depend")
    assert sorted(stated) == sorted(used(PACKAGES[name]))


@pytest.mark.parametrize("name", PACKAGES)
def test_the_manifest_names_what_the_build_uses(name):
    tools = ["catkin", "python3-setuptools"] if (PACKAGES[name] / "setup.py").exists() else ["catkin"]
    assert named(PACKAGES[name], "depend", "build_depend", "exec_depend", "test_depend") == tools


@pytest.mark.parametrize("name", PACKAGES)
def test_the_tests_use_what_is_named_for_them(name):
    tests = {module for file in (PACKAGES[name] / "tests").rglob("*.py") for module in names(file)}
    assert set(named(PACKAGES[name], "buildtool_depend", "depend", "build_depend", "exec_depend")) <= tests


def of_install_space(folder: Path) -> Iterator[str]:
    """What nodes, launch files and terminals look for in a package: its programs, and its folders and files of data."""
    for path in folder.iterdir():
        if path.name in ("scripts", "shell"):
            yield from (f"{path.name}/{file.name}" for file in path.iterdir() if file.is_file())
        elif path.name == "plugin.xml" or (path.is_dir() and path.name not in MADE_OR_NOT_USED):
            yield path.name


@pytest.mark.parametrize("name", PACKAGES)
def test_an_install_space_has_what_the_package_reads_and_starts(name):
    rules = re.findall(r"install\w*\(\s*(?:PROGRAMS|DIRECTORY|FILES)\s(.*?)DESTINATION", BUILD_FILES[name], re.S)
    installed = " ".join(rules).split()
    missing = [path for path in of_install_space(PACKAGES[name]) if not {path, path.split("/")[0]} & {*installed}]
    assert missing == []
    assert ("catkin_python_setup()" in BUILD_FILES[name]) is (PACKAGES[name] / "setup.py").exists()


def test_rosdep_knows_every_key():
    keys = {key for folder in PACKAGES.values() for key in named(folder)} - set(PACKAGES)
    assert keys == OWN.keys() | PUBLIC


def requirements(name: str) -> list[Requirement]:
    lines = (line.split("#")[0].strip() for line in (ROOT / name).read_text().splitlines())
    return [Requirement(line) for line in lines if line]


@pytest.mark.parametrize("system", ["debian", "ubuntu"])
def test_rosdep_installs_the_requirements_by_pip(system):
    of_pip = {key: rules[system]["pip"]["packages"] for key, rules in OWN.items() if isinstance(rules[system], dict)}
    names = [pin.name for pin in requirements("requirements.txt") if pin.name not in OF_THE_SYSTEM]
    assert of_pip == {f"leap-rig-{name.replace('-python-headless', '')}": [name] for name in names}

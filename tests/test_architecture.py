"""The layers of the workspace, checked by reading its source.

1. Never upward, never sideways among the features. 2. Pure files have no ROS, sockets, clock, files or printing.
3. Nothing imports the simulation but tests, and the simulation imports no feature. 4. Importing a module has no effect.
"""

from __future__ import annotations

import ast
import functools
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from tools.python38 import FOLDERS
from tools.reference.syntax import dotted

ROOT = Path(__file__).parents[1]
LAYER = {
    "kuka_msgs": 0, "reflex_msgs": 0, "rig_msgs": 0, "grasp_msgs": 0,
    "iiwa_kinematics": 0, "rig_description": 1,
    "common": 1,
    "kst": 2, "leap_motion": 2, "reflex": 2, "apriltag_ros": 2,
    "kuka_control": 3, "leap_kuka": 3, "leap_hand": 3, "vision": 3, "grasping": 3,
    "leap_rig": 4, "rig_simulation": 4,
}  # fmt: skip
ROS = {"rospy", "actionlib", "tf2_ros", "tf2_msgs", "roslaunch", "rosgraph", "rospkg", "geometry_msgs", "std_msgs",
       "std_srvs", "sensor_msgs", "diagnostic_msgs", "visualization_msgs", "rosgraph_msgs", "kuka_msgs",
       "reflex_msgs", "rig_msgs", "grasp_msgs"}  # fmt: skip
IMPURE = {"socket", "time", "threading", "subprocess", "select", "selectors", "asyncio", "websockets", "os", "logging"}
# The edge files: they may hold sockets, clocks and threads.
EDGES = {"transport", "client", "clock", "runtime", "calibration_files", "recording_files", "screen", "server",
         "socket_service", "certificate", "hand_detector", "video_source", "webcam_program",
         "command_line", "webrtc"}  # fmt: skip
# Libraries that stand alone: what their pure halves may import beside themselves, numpy and the standard library.
ALONE = {"iiwa_kinematics": set(), "kst": set(), "leap_motion": {"websockets"}, "reflex": {"yaml"}}
# Their extras: folders whose users install more.
EXTRAS = {"leap_motion/webcam": {"cv2", "mediapipe", "python_qt_binding", "yaml"}}
# Time and threads, and what of them only measures a duration or names a date.
CLOCKED = {"time", "threading", "queue", "sched", "concurrent.futures"}
MEASURES = {"perf_counter", "strftime", "gmtime"}
# Where they come from; transports that wait for a socket or a camera; and what counts the threads of others.
TIMED_EDGES = {
    "common/clock.py", "leap_motion/runtime.py", "reflex/runtime.py",
    "kst/transport.py", "leap_motion/transport.py", "headset/transport.py", "webcam/video_source.py",
    "webcam/webcam_program.py",
    "common/ros/node.py", "recording/viewer.py",
    "sunrise/server.py", "stereo/view_node.py",
}  # fmt: skip
EFFECTS = {"open", "print", "input"}
# What may stand at the top of a module besides definitions: constants are made of literals and of pure calls.
STATEMENTS = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Assign,
              ast.AnnAssign)  # fmt: skip

# What Python got after 3.8 and tools/python38.py, which goes by types, does not see; ruff refuses newer syntax.
NEWER_TYPES = {f"{name}[]" for name in ("dict", "frozenset", "list", "set", "tuple", "type")}
NEWER_METHODS = {
    "bit_count", "hardlink_to", "is_relative_to", "removeprefix", "removesuffix", "with_stem", "add_note",
}  # fmt: skip
PYTHON = sorted({ROOT / "conftest.py", *(file for folder in FOLDERS for file in ROOT.glob(f"{folder}/**/*.py"))})

FILES = sorted(ROOT.glob("src/**/src/*/**/*.py"))
MODULES = {
    ".".join(path.parts[len(path.parts) - path.parts[::-1].index("src") :])[: -len(".py")]: path for path in FILES
}


BUILT = {f"{name}.{kind}" for name in LAYER for kind in ("msg", "srv")}  # messages of this workspace
IMPORTED = {
    **{".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in PYTHON},
    **{path.stem: path for path in PYTHON if path.parent.name == "tests"},
    **MODULES,
}


def package(path: Path) -> str:
    return path.parts[len(path.parts) - 1 - path.parts[::-1].index("src") + 1]


def in_ros(path: Path) -> bool:
    return "ros" in path.parts[path.parts.index("src") + 2 :]


@functools.lru_cache(maxsize=None)
def tree_of(path: Path) -> ast.Module:
    return parsed(path.read_text())


def parsed(code: str) -> ast.Module:
    """Parses as Python 3.8 does, whose newest syntax the files may have."""
    return ast.parse(code, feature_version=(3, 8))


@functools.lru_cache(maxsize=None)
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(tree_of(path)))


@functools.lru_cache(maxsize=None)
def imports(path: Path) -> set[str]:
    names = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import hides where the name comes from"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def tops(path: Path) -> set[str]:
    return {name.split(".")[0] for name in imports(path)}


def test_imports_go_down():
    wrong = []
    for path in FILES:
        own = package(path)
        for name in imports(path):
            other = name.split(".")[0]
            if other not in LAYER or other == own:
                continue
            if LAYER[other] >= LAYER[own] or (own == "rig_simulation" and LAYER[other] >= 3):
                wrong.append(f"{path} must not import {name}")
    assert not wrong


def test_pure_files_are_pure():
    wrong = []
    for path in FILES:
        if package(path) == "rig_simulation" or in_ros(path):
            continue
        wrong += [f"{path}: {name} belongs into ros/" for name in tops(path) & ROS]
        wrong += [f"{path}: {name}" for name in imports(path) if f"{name}.".startswith(f"{package(path)}.ros.")]
        if path.stem in EDGES:
            continue
        wrong += [f"{path}: {name} belongs into ros/ or into an edge file" for name in tops(path) & IMPURE]
        for node in nodes_of(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in EFFECTS:
                wrong.append(f"{path}:{node.lineno} calls {node.func.id}")
    assert not wrong


def own_times(nodes: Iterable[ast.AST]) -> set[str]:
    """Returns the modules of time and threads of which a file takes more than what measures and names times."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not {alias.name for alias in node.names} <= MEASURES:
            found.add(str(node.module))
    return found & CLOCKED


class TestTime:
    """Time and threads come from common.clock, so that a simulation can put its own in place of them."""

    def test_comes_from_the_clock(self):
        """Reported in https://github.com/ros/ros_comm/pull/1083, https://github.com/ros/ros_comm/issues/485: rospy's
        timers end when a bag begins anew. Tried: all nodes.
        """
        files = {"/".join(path.parts[-3:]): path for path in FILES}
        assert all(any(file.endswith(edge) for file in files) for edge in TIMED_EDGES)
        others = {name: path for name, path in files.items() if not name.endswith(tuple(TIMED_EDGES))}
        own = {name: own_times(nodes_of(path)) for name, path in others.items()}
        assert not {name: modules for name, modules in own.items() if modules}

    def test_is_looked_up_when_it_is_used(self):
        names = [name for path in FILES for name in imports(path) if name.startswith("common.clock.")]
        assert not names, "a name that is imported from common.clock stays the standard library's"

    @pytest.mark.parametrize(
        ("code", "found"),
        [
            ("import time", {"time"}),
            ("import queue, threading", {"queue", "threading"}),
            ("from time import monotonic", {"time"}),
            ("from time import perf_counter, sleep", {"time"}),
            ("def f():\n    from threading import Thread", {"threading"}),
            ("from time import perf_counter, strftime", set()),
            ("from common import clock", set()),
        ],
    )
    def test_is_found(self, code, found):
        assert own_times(ast.walk(parsed(code))) == found


def test_libraries_stand_alone():
    foreign = {}
    for path in FILES:
        if package(path) in ALONE and not in_ros(path):
            allowed = {package(path), "numpy"} | ALONE[package(path)]
            allowed |= EXTRAS.get("/".join(path.parts[-3:-1]), set())
            foreign[path] = tops(path) - set(getattr(sys, "stdlib_module_names", tops(path))) - allowed
    assert foreign and not {path: names for path, names in foreign.items() if names}


def test_simulation_keeps_ros_in_its_ros_folder():
    pure = [path for path in FILES if package(path) == "rig_simulation" and not in_ros(path)]
    assert pure and not {path: tops(path) & ROS for path in pure if tops(path) & (ROS - {"rospkg"})}


def needed_at_import(file: ast.Module) -> set[str]:
    """Returns the packages of ROS that a file of tests imports at its top without pytest.importorskip before, or
    messages of this workspace for which it skips although not all its tests are marked `ros`: they would never run.
    """
    needed: set[str] = set()
    skips: set[str] = set()
    marked = False
    for node in file.body:
        names = {name for module in imported_by(node) for name in ros_of(module)}
        needed |= set() if skips & BUILT else names & BUILT if skips else names
        call = getattr(node, "value", None)
        if isinstance(call, ast.Call) and dotted(call.func) == "pytest.importorskip":
            skips |= ros_of(ast.literal_eval(call.args[0]))
        if isinstance(node, ast.Assign) and dotted(node.targets[0]) == "pytestmark":
            marked = "pytest.mark.ros" in {dotted(mark) for mark in ast.walk(node.value)}
    return needed or (set() if marked else skips & BUILT)


class TestFilesOfTests:
    """They are collected where ROS is not built or not installed; a mark comes too late, as pytest imports the file."""

    def test_import_no_ros_that_may_be_absent(self):
        files = (file for file in PYTHON if file.name.startswith("test_") or file.name == "conftest.py")
        needed = {str(file.relative_to(ROOT)): needed_at_import(tree_of(file)) for file in files}
        assert not {file: names for file, names in needed.items() if names}

    MARK = "import pytest\npytestmark = [pytest.mark.ros]\n"

    @pytest.mark.parametrize(
        ("code", "found"),
        [
            ("import rospy", {"rospy"}),
            ("from leap_motion.msg import Human", {"leap_motion.msg"}),
            ("import kuka_msgs.srv", {"kuka_msgs.srv"}),
            (f"{MARK}from kuka_msgs.msg import Hand", {"kuka_msgs.msg"}),
            ("from campaign import clocks", {"rospy", "rosgraph_msgs"}),
            (f"{MARK}def test_a():\n    pytest.importorskip('rospy')\nimport rospy", {"rospy"}),
            (f"{MARK}import rospy\npytest.importorskip('rospy')", {"rospy"}),
            (f"{MARK}pytest.importorskip('rospy')\nfrom rig_msgs.srv import HoldTool", {"rig_msgs.srv"}),
            ("pytest.importorskip('rig_msgs.srv')\nfrom rig_msgs.srv import HoldTool", {"rig_msgs.srv"}),
            (f"{MARK}pytest.importorskip('rig_msgs.srv')\nfrom rig_msgs.srv import HoldTool\nimport rospy", set()),
            ("rospy = pytest.importorskip('rospy')\nimport rospy", set()),
            ("def test_a():\n    import rospy", set()),
            ("import numpy", set()),
        ],
    )
    def test_are_found(self, code, found):
        assert needed_at_import(parsed(code)) == found


def imports_at_top(path: Path) -> set[str]:
    return {name for node in tree_of(path).body for name in imported_by(node)}


def imported_by(node: ast.AST) -> set[str]:
    if isinstance(node, ast.ImportFrom):
        return {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {alias.name for alias in node.names} if isinstance(node, ast.Import) else set()


@functools.lru_cache(maxsize=None)
def ros_of(module: str) -> frozenset[str]:
    """Returns the packages of ROS and the modules of this workspace's messages that the import of a module needs."""
    if module in BUILT:
        return frozenset({module})
    name = module.split(".")[0]
    if name in ROS - LAYER.keys():
        return frozenset({name})
    path = IMPORTED.get(module)
    return frozenset().union(*(ros_of(name) for name in imports_at_top(path))) if path else frozenset()


def test_import_has_no_effect():
    acting = []
    for path in FILES:
        for node in tree_of(path).body:
            text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            types = isinstance(node, ast.If) and dotted(node.test).endswith("TYPE_CHECKING")
            if not (text or types or isinstance(node, STATEMENTS)):
                acting.append(f"{path}:{node.lineno}")
    assert not acting, "acts when it is imported"


def test_every_module_has_a_docstring():
    assert not [path for path in FILES if not ast.get_docstring(tree_of(path)) and path.read_text().strip()]


def newer_than_38(nodes: Iterable[ast.AST]) -> set[str]:
    """Returns what a file uses of the names above."""
    nodes = list(nodes)
    tree = nodes[0]
    plain = NEWER_TYPES | {f"{name}[]" for name in _imported(nodes, ("collections", "collections.abc"))}
    unread = {part for node in nodes for part in _annotation(node)} if "annotations" in _future(tree) else set()
    found = set()
    for node in nodes:
        if isinstance(node, ast.Attribute):
            found |= {node.attr} & NEWER_METHODS
        elif isinstance(node, ast.Subscript) and node not in unread:
            found |= {f"{dotted(node.value)}[]"} & plain
    return found


def _imported(nodes: Iterable[ast.AST], modules: tuple[str, ...]) -> set[str]:
    found = (node for node in nodes if isinstance(node, ast.ImportFrom) and node.module in modules)
    return {alias.name for node in found for alias in node.names}


def _annotation(node: ast.AST) -> Iterator[ast.AST]:
    """Yields what stands in the annotation that belongs to a node."""
    for annotation in (getattr(node, "annotation", None), getattr(node, "returns", None)):
        if annotation is not None:
            yield from ast.walk(annotation)


def _future(tree: ast.Module) -> set[str]:
    imports = (n for n in tree.body if isinstance(n, ast.ImportFrom) and n.module == "__future__")
    return {alias.name for statement in imports for alias in statement.names}


class TestPython38:
    """ROS Noetic on Ubuntu 20.04 has Python 3.8."""

    def test_has_what_is_used(self):
        used = {str(path.relative_to(ROOT)): newer_than_38(nodes_of(path)) for path in PYTHON}
        assert not {path: names for path, names in used.items() if names}

    @pytest.mark.parametrize(
        ("code", "found"),
        [
            ("name.removeprefix('a')", "removeprefix"),
            ("path.is_relative_to(root)", "is_relative_to"),
            ("def f(a: list[int]): pass", "list[]"),
            ("from collections import Counter\nCounter[str]()", "Counter[]"),
            ("from collections.abc import Callable\nReader = Callable[[int], str]", "Callable[]"),
            ("from __future__ import annotations\nNames = dict[str, int]", "dict[]"),
        ],
    )
    def test_finds(self, code, found):
        assert newer_than_38(ast.walk(parsed(code))) == {found}

    def test_annotations_may_be_newer_where_nobody_reads_them(self):
        code = "from __future__ import annotations\ndef f(a: list[int]) -> dict[str, int]: pass"
        assert not newer_than_38(ast.walk(parsed(code)))


def test_every_package_has_a_layer():
    assert {p.parent.name for p in ROOT.glob("src/**/package.xml")} <= LAYER.keys()


def test_a_class_name_means_one_thing():
    places = defaultdict(list)
    for path in FILES:
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(ROOT)))
    assert not {name: files for name, files in places.items() if len(files) > 1}


def test_what_rospy_keeps_for_itself_is_asked_in_one_place():
    """A release of rospy that names it otherwise then changes one file, and the simulated graph."""
    places = {"_buff": "common/ros/raw_tf.py", "_connection_header": "common/ros/raw_tf.py", "impl": "common/ros/"}
    asked = [
        (str(path.relative_to(ROOT)), node.attr)
        for path in PYTHON
        if path.relative_to(ROOT).parts[0] != "simulated" and "tests" not in path.parts
        for node in nodes_of(path)
        if isinstance(node, ast.Attribute) and node.attr in places
    ]
    assert {name for _, name in asked} == places.keys()
    assert not [(file, name) for file, name in asked if places[name] not in file]


def test_the_robot_hand_is_named_in_its_record_alone():
    """A rig with another hand then changes common/robot_hand.py, its driver and the launch files."""
    named = [path for path in FILES if "reflex_takktile/" in path.read_text()]
    assert {package(path) for path in named} == {"reflex", "common"}, named
    assert [path.name for path in named if package(path) == "common"] == ["robot_hand.py"]


def test_subscribers_of_images_have_room_for_several():
    """rospy drops all but the newest only among those that it has read: with its own room images become ever older.

    Reported in https://github.com/ros/ros_comm/issues/536: with rospy's own buffer images become ever older.
    Tried: all subscribers of images.
    """
    calls = [(path, node) for path in FILES for node in nodes_of(path) if isinstance(node, ast.Call)]
    images = [(path, call) for path, call in calls if dotted(call.func).endswith("Subscriber")
              and any(dotted(part) == "Image" for part in call.args)]  # fmt: skip
    assert not [path for path, call in images if not {"buff_size", None} & {word.arg for word in call.keywords}]


def test_every_folder_says_what_is_in_it():
    folders = {path.parent for path in FILES}
    assert not [str(folder.relative_to(ROOT)) for folder in folders if not (folder / "__init__.py").is_file()]
    silent = {str(folder.relative_to(ROOT)) for folder in folders if not (folder / "__init__.py").read_text().strip()}
    assert silent <= {"src/modules/reflex/src/reflex", "src/modules/reflex/src/reflex/ros"}


def test_scripts_are_short_and_not_named_like_packages():
    for script in ROOT.glob("src/**/scripts/*.py"):
        assert script.stem not in LAYER, f"{script} would hide the package of the same name"
        assert len(script.read_text().splitlines()) <= 20, f"{script} holds more than a call"
        assert script.stat().st_mode & 0o111, f"{script} is not executable"


def test_every_launch_argument_has_a_doc():
    import xml.etree.ElementTree as ElementTree

    for launch in ROOT.glob("src/**/launch/*.launch"):
        for arg in ElementTree.parse(launch).getroot().findall("arg"):
            assert arg.get("doc") or arg.get("value") is not None, (
                f"{launch}: the argument {arg.get('name')} has no doc"
            )


GRASPING = ROOT / "src/grasping/src/grasping"
# Each room of the live half, and the rooms that it may import besides itself.
LIVE_ROOMS = {
    "network": set(),
    "poses": {"network"},
    "pipeline": {"poses", "network"},
    "execution": {"pipeline", "network"},
    "ros": {"execution", "pipeline", "poses", "network"},
}  # fmt: skip


@pytest.mark.parametrize("room", LIVE_ROOMS)
def test_live_grasping_does_not_import_the_laboratory(room):
    for path in (GRASPING / room).rglob("*.py"):
        rooms = {name.split(".")[1] for name in imports(path) if name.startswith("grasping.")}
        assert rooms <= LIVE_ROOMS[room] | {room}, f"{path}: {room} must not import {rooms - LIVE_ROOMS[room] - {room}}"


def test_the_node_that_holds_the_tool_above_a_grasp_loads_no_torch():
    """It would take seconds of the processor and 150 MB."""
    reached, left = set(), {"grasping.ros.execution_node"}
    while left:
        reached |= left
        left = {name for module in left & MODULES.keys() for name in imports_at_top(MODULES[module])} - reached
    assert "grasping.execution.execution" in reached and "torch" not in reached


def test_grasping_has_no_other_rooms():
    assert {p.parent.name for p in GRASPING.glob("*/*.py")} == {*LIVE_ROOMS, "lab"}


KUKA_CONTROL = ROOT / "src/kuka_control/src/kuka_control"


@pytest.mark.parametrize("room, above", [("model", {"limits", "loop", "gui"}), ("limits", {"loop", "gui"})])
def test_kuka_control_imports_run_from_loop_to_limits_to_model(room, above):
    for path in (KUKA_CONTROL / room).rglob("*.py"):
        rooms = {name.split(".")[1] for name in imports(path) if name.startswith("kuka_control.")}
        assert not rooms & above, f"{path}: {room} must not import {rooms & above}"

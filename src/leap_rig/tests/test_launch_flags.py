"""A flag of a launch file may be typed as roslaunch allows: true, True, 1, false, False, 0."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rig_msgs.srv")
from tools import launched
from tools.reference.launch_files import arguments

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[3]
LAUNCH_FILES = sorted(ROOT.glob("src/**/launch/*.launch"))
WORDS = {"true": ("True", "1"), "false": ("False", "0")}
ABSENT = "openni2_launch"  # the package that it names is not installed everywhere
ROSLAUNCHS_OWN = "required"  # an attribute of a node, of which roslaunch itself refuses 1 and 0


def started(path: Path, arguments: tuple[str, ...]) -> tuple[list[Any], dict[str, Any]]:
    """Returns the nodes that these arguments start, and the parameters that they set, with their types."""
    loaded = launched.config(path.parents[1].name, path.name, arguments)
    nodes = [(node.namespace, node.name, node.args, node.launch_prefix) for node in loaded.nodes]
    return nodes, {name: (type(param.value), param.value) for name, param in loaded.params.items()}


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: f"{path.parents[1].name}-{path.stem}")
def test_true_and_1_mean_the_same_wherever_an_argument_goes(path):
    defaults = {name: arg.get("default") for name, arg in arguments(path).items()}
    given = tuple(f"{name}:=left" for name, default in defaults.items() if default is None)
    flags = [name for name, default in defaults.items() if default in WORDS if name not in (ABSENT, ROSLAUNCHS_OWN)]
    for names in ([*flags], [name for name in flags if name == "sim"]):
        for word, others in WORDS.items() if names else ():
            expected = started(path, (*given, *(f"{name}:={word}" for name in names)))
            for other in others:
                assert started(path, (*given, *(f"{name}:={other}" for name in names))) == expected, (names, other)

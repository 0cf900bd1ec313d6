"""The tf frames have one name each, which stands in one place."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from common import frames
from common.config import parse

SRC = Path(__file__).parents[2]
NAMES = {value for name, value in vars(frames).items() if name.isupper()}


def literals(file: Path) -> set[str]:
    nodes = ast.walk(ast.parse(file.read_text()))
    return {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def test_no_frame_name_is_written_elsewhere():
    # rig_description is data below common; the next test compares it.
    files = [f for f in SRC.glob("**/src/**/*.py") if f.stem != "frames" and "rig_description" not in f.parts]
    assert len(files) > 100
    names = NAMES - {frames.WORLD}  # a program is called so, too
    assert not {file.name: found for file in files if (found := literals(file) & names)}


def test_base_and_flange_are_links_of_the_robot_description():
    root = ET.parse(str(next(SRC.glob("modules/rig_description/urdf/*.urdf")))).getroot()
    assert {frames.BASE, frames.FLANGE} <= {link.get("name") for link in root.iter("link")}


@pytest.mark.parametrize(("given", "name"), [("/a", "a"), ("a/b", "a/b"), ("//a/b", "a/b"), ("", ""), ("/", "")])
def test_a_leading_slash_of_a_frame_is_taken_off(given, name):
    assert frames.frame_name(given) == name


def test_the_prefix_of_an_arm_may_have_one():
    assert parse(frames.ArmFrames, {"tf_prefix": "/left"})("a") == "left/a"


def test_one_function_does_so():
    own = re.compile(r"frame\w*(\.decode\(\))?\.(lstrip|removeprefix)\(|decode\(\)\.lstrip\(")
    assert not [file.name for file in SRC.glob("**/src/**/*.py") if own.search(file.read_text())]

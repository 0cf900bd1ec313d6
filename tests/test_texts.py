"""Names that yaml, rosparam or roslaunch read as another type: taken as the text that they are, or refused."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from common.camera_model import from_calibration
from common.config import QUOTE_IT, choice, keys, names, parse, text
from common.errors import ConfigError
from common.ros.files import read_yaml

pytest.importorskip("rig_msgs.srv")
import rospy

from common.ros.node import run
from common.ros.params import private_config, private_values
from tools import launched

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("7", "007", "1504200123", "on", "No", "1e3", "1_000", "0x10", "1:30", ".5", ".inf", "null", "~", "true",
         "2001-01-01", "2001-13-45", "2001-01-01T12:00:00Z", "=", "-x", "Jürgen Müller")  # fmt: skip
NO_YAML = ("2001-13-45", "=")
"""Of which PyYAML makes nothing."""
NO_PARAMETER = ("null", "~", "2001-01-01")
"""Of which it makes what the parameter server cannot hold."""
KINDS = ("text", "names")


def text_fields() -> list[tuple[str, str, str, str]]:
    """Returns module, schema, key and kind of each field of a schema in the tree that is a text or a list of them."""
    found = []
    for file in sorted(ROOT.glob("src/**/src/**/*.py")):
        if "text(" not in file.read_text() and "names(" not in file.read_text():
            continue
        module = ".".join(file.with_suffix("").parts[file.parts.index("src", len(ROOT.parts) + 2) + 1 :])
        for node in ast.walk(ast.parse(file.read_text())):
            for one in node.body if isinstance(node, ast.ClassDef) else ():
                kind = getattr(getattr(getattr(one, "value", None), "func", None), "id", "")
                if isinstance(one, ast.AnnAssign) and kind in KINDS:
                    found.append((module, node.name, one.target.id, kind))
    return found


FIELDS = text_fields()


def test_the_fields_are_found():
    assert {("grasping.lab.ros.collection_setup", "CollectionConfig", "operator", "text"),
            ("vision.calibration.record", "RecordHead", "camera", "text"),
            ("kuka_control.model.config", "DhDeviations", "serial", "text"),
            ("leap_rig.teleop_config", "LeapTeleopConfig", "arms", "names")} <= set(FIELDS)  # fmt: skip


@pytest.mark.parametrize(("module", "schema", "key", "kind"), FIELDS)
def test_each_text_of_each_schema(module, schema, key, kind, tmp_path):
    """In a file it is what is written there; from the parameter server too, or the sentence says to quote it.

    Reported in https://github.com/ros2/launch_ros/issues/384: the text 123E5 becomes a number. Tried: each text
    parameter with such values, in yaml.
    """
    whole = getattr(importlib.import_module(module), schema)
    (field,) = (one for one in dataclasses.fields(whole) if one.name == key)
    alone = dataclasses.make_dataclass("Alone", [(key, str, dataclasses.field(metadata=field.metadata))], frozen=True)
    file = tmp_path / "names.yaml"

    def of(values):
        found = getattr(parse(alone, values), key)
        return found[0] if kind == "names" else found

    for name in NAMES:
        value = [name] if kind == "names" else name
        file.write_text(f"{key}: {f'[{name}]' if kind == 'names' else name}\n")
        assert of(read_yaml(file)) == name
        file.write_text(yaml.safe_dump({key: value}))
        assert of(read_yaml(file)) == of(yaml.safe_load(file.read_text())) == name
        with_type = yaml.safe_load(f"[{name}]") if name not in NO_YAML else [name]
        if isinstance(with_type[0], str):
            assert of({key: with_type if kind == "names" else name}) == name
            continue
        with pytest.raises(ConfigError) as refused:
            parse(alone, {key: with_type if kind == "names" else with_type[0]})
        (fault,) = refused.value.faults
        assert fault.startswith(f"{key} is ") and fault.endswith(f"{QUOTE_IT}.")


def test_no_option_of_a_choice_needs_quotes():
    for module in {module for module, *_ in FIELDS}:
        for schema in vars(importlib.import_module(module)).values():
            for key in keys(schema) if dataclasses.is_dataclass(schema) and _is_schema(schema) else ():
                if key.type == "one of":
                    options = [option for option in key.range.split(", ") if option]
                    assert [yaml.safe_load(option) for option in options] == options


def _is_schema(found) -> bool:
    return all("kind" in field.metadata for field in dataclasses.fields(found))


@dataclasses.dataclass(frozen=True)
class Part:
    serial: str = text()


@dataclasses.dataclass(frozen=True)
class Names:
    arms: tuple = names()


@dataclasses.dataclass(frozen=True)
class Whole:
    operator: str = text()
    side: str = choice("left", "right", absent="left")


@pytest.mark.parametrize("name", [name for name in NAMES if name not in NO_YAML + NO_PARAMETER])
def test_a_private_parameter_on_the_command_line_is_the_text_until_it_is_set_again(virtual_graph, name):
    """Reported in https://github.com/ros/ros_comm/issues/1339, https://github.com/ros/ros_comm/issues/1153: a serial
    number on the command line is no text, whatever the quotes. Tried: `_serial:=0042`.
    """
    read = []

    def main():
        read.append(private_config(Whole, others=("part", "other")).operator)
        read.append(private_config(Part, "part").serial)
        rospy.set_param("~operator", 8)
        read.append(private_values()["operator"])
        read.append(private_values().texts)
        read.append(private_config(Names, "other").arms)

    given = (f"_operator:={name}", f"_part/serial:={name}", "_other/arms:=[left, right]")
    virtual_graph.start("texts", lambda: run_node(main), "texts", *given).wait(1.0)
    assert read == [name, name, 8, {}, ("left", "right")]


def test_what_the_parameter_server_cannot_hold_ends_the_node_with_a_sentence(virtual_graph, monkeypatch):
    def init_node(*_, **__):
        raise TypeError("cannot marshal <class 'datetime.date'> objects")

    monkeypatch.setattr(rospy, "init_node", init_node)
    node = virtual_graph.start("texts", lambda: run_node(lambda: None), "texts")
    assert node.wait(1.0) == 1 and "Quote a date" in node.log


def run_node(main) -> None:
    run("texts", main)


@pytest.mark.parametrize("name", NAMES)
def test_the_name_in_a_calibration_is_a_label_without_quotes(tmp_path, name):
    """camera_calibration_parsers writes it so, and rosparam reads it."""
    file = tmp_path / "camera.yaml"
    shipped = (ROOT / "src/vision/config/xtion_rgb.yaml").read_text()
    file.write_text(re.sub(r"camera_name: .*", f"camera_name: {name}", shipped))
    assert from_calibration(read_yaml(file)).name == name
    if name not in NO_YAML + NO_PARAMETER:
        assert from_calibration(yaml.safe_load(file.read_text())).name.strip()


LAUNCH = sorted(ROOT.glob("src/**/launch/*.launch"))


@pytest.mark.parametrize("file", LAUNCH, ids=lambda path: path.stem)
def test_a_parameter_that_is_a_text_says_so_where_roslaunch_would_make_a_number_of_007(file):
    from roslaunch.loader import convert_value

    root = ElementTree.parse(file).getroot()
    defaults = {arg.get("name"): arg.get("default", "") for arg in root.findall("arg")}
    for param in root.iter("param"):
        given = re.fullmatch(r"\$\(arg (\w+)\)", param.get("value", ""))
        default = defaults[given[1]] if given else "0"  # an argument's value may be computed: of numbers and flags
        is_text = "$(" not in default and isinstance(convert_value(default, "auto"), str)
        assert param.get("type") or not is_text, param.attrib
        assert param.get("type") or not param.get("command"), param.attrib
    assert not any("$(arg" in (one.text or "") for one in root.iter("rosparam")), "yaml would read the argument"


@pytest.mark.parametrize("name", NAMES)
def test_the_arguments_of_the_launch_files_are_the_texts_that_they_are(name):
    def parameters(file, *arguments):
        return launched.parameters(file.parts[0], file.name, *(f"{one}:={name}" for one in arguments))

    demo, scene = Path("leap_rig/demo.launch"), ("leap_rig", "simulated_devices.launch")
    values = parameters(demo, "leap_code", "leap_host", "registration", "camera_fault", "hand_interface", "robot_ip")
    assert [values[f"/leap_driver/{key}"] for key in ("code", "host", "registration")] == [name] * 3
    assert values["/kuka/ip"] == values["/reflex_takktile_driver/network_interface"] == name
    assert values["/camera/driver/fault"] == name
    values = parameters(Path("grasping/collect.launch"), "object", "operator", "folder")
    assert [values[f"/grasp_collection/{key}"] for key in ("object", "operator", "folder")] == [name] * 3
    values = parameters(Path("vision/camera_apriltag.launch"), "serial", "folder")
    assert [values[f"/camera_calibration/store/{key}"] for key in ("camera", "folder")] == [name] * 2
    line = launched.command_line(*scene, "simulated_world", f"scene:={name}", "tracker:=webcam")
    assert f"--scene={name}" in line
    line = launched.command_line(*scene, "recorder", f"record:={name}")
    assert line[-2:] == ["--", name]
    for key in ("recording", "video", "camera_device"):
        tracker = "leap" if key == "recording" else "webcam"
        line = launched.command_line(*scene, "leapd", f"{key}:={name}", f"tracker:={tracker}")
        assert f"--{'camera' if key == 'camera_device' else key}={name}" in line

"""The types that pass through the bridge, against ROS 2's own: definitions, and bytes that were written by ROS 2."""

import itertools
import json
import re
import socket
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("rig_msgs.srv")
import roslib.message
import rospy

from leap_rig.ros2.channels import channels
from leap_rig.ros2.ros.bridge_node import SOURCES
from leap_rig.ros2.ros.bytes_of import bytes_of

PYTHON = Path(__file__).parents[3] / ".venv-ros2" / "bin" / "python"
TYPES = Path(__file__).with_name("ros2_types.py")
GOLDEN = json.loads(Path(__file__).with_name("ros2_messages.json").read_text())
MOVE = [f"kuka_msgs/Move{part}" for part in ("Goal", "Result", "Feedback")]
LISTS = re.compile(r"([\w/]+)\[(\d*)\]")

pytestmark = pytest.mark.ros


def filled(kind, numbers):
    """Returns a message in which no two fields are the same; as that of ros2_types.py, but with ROS 1."""
    message = roslib.message.get_message_class(kind)()
    for name, slot in zip(message.__slots__, message._slot_types):
        if (kind, name) != ("std_msgs/Header", "seq"):  # which ROS 2 lacks
            setattr(message, name, value(slot, numbers))
    return message


def value(kind, numbers):
    found = LISTS.fullmatch(kind)
    if found:
        made = [value(found[1], numbers) for _ in range(int(found[2] or 2))]
        return bytes(made) if found[1] == "uint8" else made
    if "/" in kind:
        return filled(kind, numbers)
    number = next(numbers)
    if kind == "time":
        return rospy.Time(number, next(numbers))
    return {"float64": number + 0.5, "string": f"s{number}", "bool": True}.get(kind, number)


def test_each_type_of_a_channel_has_golden_bytes():
    kinds = {channel.kind for channel in channels()} | {*MOVE}
    assert {kind: bytes_of(filled(kind, itertools.count(1))).hex() for kind in kinds} == {
        kind: row["ros1"] for kind, row in GOLDEN.items()
    }


@pytest.mark.long
@pytest.mark.skipif(not PYTHON.is_file(), reason="ROS 2 is not installed: make ros2")
def test_bytes_and_definitions_are_those_of_ros2():
    rows = [(k, roslib.message.get_message_class(k)._full_text, row["ros1"]) for k, row in GOLDEN.items()]
    program = f"import runpy, sys; sys.path.extend({SOURCES!r}); runpy.run_path({str(TYPES)!r})"
    done = subprocess.run(
        [str(PYTHON), "-c", program], input=json.dumps(rows), capture_output=True, text=True, timeout=120.0,
        env={"HOME": str(Path.home())},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for kind, found in json.loads(done.stdout).items():
        ros1, cdr = GOLDEN[kind]["ros1"], GOLDEN[kind]["ros2"]
        assert found == {"ros2": cdr, "bridge": cdr, "read as sent": True, "back": ros1, "same definition": True}, kind


OTHER_TYPES = """
import sys
sys.path.extend({sources!r})
from leap_rig.ros2.ros import side
class Changed(side.Ros2Conversions):
    def __init__(self):
        super().__init__()
        constants, fields = self.store.fielddefs["geometry_msgs/msg/Wrench"]
        self.store.fielddefs["geometry_msgs/msg/Wrench"] = constants, fields[::-1]
if {changed!r} == "wrench":
    side.Ros2Conversions = Changed
side.main()
"""


@pytest.mark.long
@pytest.mark.skipif(not PYTHON.is_file(), reason="ROS 2 is not installed: make ros2")
@pytest.mark.parametrize(
    "changed, said",
    [
        ("wrench", ("/kuka/flange_wrench", "geometry_msgs/msg/WrenchStamped", "geometry_msgs/WrenchStamped")),
        ("goal", ("kuka/move", "kuka_msgs/action/Move_Goal", "kuka_msgs/MoveGoal")),
    ],
)
def test_a_ros2_whose_types_differ_ends_the_bridge_in_a_sentence(changed, said):
    definitions = {kind: roslib.message.get_message_class(kind)._full_text for kind in MOVE}
    if changed == "goal":
        definitions["kuka_msgs/MoveGoal"] = definitions["kuka_msgs/MoveGoal"].replace(
            "float64 velocity", "float32 velocity"
        )
    rows = [[c.number, c.topic, c.kind, c.depth, c.is_latched] for c in channels()]
    ours, theirs = socket.socketpair()
    with ours, theirs:
        request = {
            "channels": rows,
            "desired": [],
            "moves": [],
            "definitions": definitions,
            "rescue": [],
            "socket": theirs.fileno(),
        }
        program = OTHER_TYPES.format(sources=SOURCES, changed=changed)
        done = subprocess.run(
            [str(PYTHON), "-c", program, json.dumps(request)], capture_output=True, text=True, timeout=120.0,
            pass_fds=[theirs.fileno()], env={"HOME": str(Path.home()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
        )  # fmt: skip
    assert done.returncode == 1
    (sentence,) = done.stderr.splitlines()
    assert all(each in sentence for each in (*said, "Run make ros2")), sentence

"""Plays a recording for collect.launch, which sets the parameters of this node: exactly the topics that it needs."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import rosgraph
from roslib.packages import find_node

from common.config import number, parse, text
from common.errors import RigError
from common.ros.master import check_master, check_surroundings
from grasping.lab.ros.bags import opened, topic_in

NAME = "collection_bag"
HAND_STATE = "/reflex_takktile/hand_state"
OTHERS = ("/tf", "/tf_static", "/leap_kuka/stream", "/grasping/state", "/grasping/outcome")  # played if they are there


@dataclass(frozen=True)
class PlayConfig:
    """The node's private parameters."""

    bag: str = text(doc="recording to play; a relative path begins where roslaunch was started")
    rate: float = number(above=0.0, high=1000.0, doc="how many times faster than recorded")
    depth: str = text(doc="topic of the depth images")
    camera_info: str = text(doc="topic of their camera's description")


def main() -> None:
    """Replaces this process with rosbag's player."""
    mappings = rosgraph.names.load_mappings(sys.argv)
    try:
        check_surroundings()
        check_master(0.0)
        node = rosgraph.names.make_caller_id(mappings.get("__name", NAME))
        try:
            values = rosgraph.Master(node).getParam(node.rstrip("/"))
        except (rosgraph.MasterException, OSError):
            raise RigError("This is a node of collect.launch: roslaunch grasping collect.launch bag:=FILE.") from None
        command = player(parse(PlayConfig, values, prefix="~"), os.environ.get("PWD", ""))
    except RigError as error:
        sys.exit(f"{NAME}: {error}")
    os.execv(command[0], [*command, *(word for word in sys.argv[1:] if ":=" in word)])


def player(config: PlayConfig, folder: str) -> list[str]:
    """Returns the command that plays a recording, paused; `folder`: where a relative path begins. Raises RigError if
    the recording cannot be read, or lacks a topic.
    """
    path = Path(folder, os.path.expanduser(config.bag))
    with opened(path) as bag:
        needed = [topic_in(bag, path, name) for name in (config.depth, config.camera_info, HAND_STATE)]
        others = [topic for topic in bag.get_type_and_topic_info().topics if f"/{topic.strip('/')}" in OTHERS]
    found = find_node("rosbag", "play")
    if not found:
        raise RigError("ROS has no rosbag play: install rosbag.")
    options = ["--quiet", "--clock", "--pause", "--rate", f"{config.rate:g}"]
    return [found[0], *options, str(path), "--topics", *needed, *others]

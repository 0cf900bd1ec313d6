"""The page of commands: the targets of make and the programs of each package."""

from __future__ import annotations

import ast
import re
from typing import NamedTuple

from tools.reference import markdown, sources


class LineAsTyped(NamedTuple):
    """A line of the report of 2019."""

    chapter: str
    typed: str
    starts: str
    missing: str  # what is said where the device does not answer
    without: str  # what to add where there is no hardware


CAMERA = "*No camera …* or what is not installed, each with *sim:=true*; `camera/driver` exits"
RIG = "*No Leap service answers …*, *No packet from the hand …* or *The network interface …*, each with *sim:=true*"
ROBOT = "*There is no connection to the robot …*, with *sim:=true*"
SIM = "`sim:=true`"
SHELL = "src/leap_rig/shell"
AS_TYPED = (
    LineAsTyped("4", f"{SHELL}/run_leapd.sh", "the Leap service", "*No Leap service is installed …*", "`--sim`"),
    LineAsTyped("4", f"{SHELL}/run_leap_control.sh", "the rig and its controller", f"{RIG}; {ROBOT}", "`--sim`"),
    LineAsTyped("4", "roslaunch leap_rig leap_rig.launch", "the rig without the arm's controller", RIG, SIM),
    LineAsTyped("4", "roslaunch leap_rig leap_rig_ptp_debug.launch", "the same, for the PTP controller", RIG, SIM),
    LineAsTyped("4", "roslaunch leap_rig demo", "**the simulated rig**; the real one with `sim:=false`", "", ""),
    LineAsTyped("5", "roslaunch vision camera_oculus.launch", "the Xtion and the headset's view", CAMERA, SIM),
    LineAsTyped("5", "roslaunch vision camera_apriltag.launch", "the Xtion, tags and camera pose", CAMERA, SIM),
    LineAsTyped("5", "roslaunch vision register_rgbd.launch", "the Xtion, its cloud and RViz", CAMERA, SIM),
    LineAsTyped("6", "roslaunch grasping grasping.launch", "the Xtion and the image viewer", CAMERA, SIM),
    LineAsTyped("6", "rosrun grasping ggcnn.py", "the network, on the images that come", "it says that none come", ""),
)
"""They mean real devices, but for the demo; nothing simulates in place of a device that does not answer."""
ROS_TOOLS = (
    ("rosparam list", "the parameters ([meaning](parameters.md)); `rosparam get /kuka/ip` shows one"),
    ("rosservice list", "the services ([all](interface.md)); `rosservice call kuka/kuka_control true` calls one"),
    ("rostopic list", "the topics ([all](interface.md)); `rostopic echo kuka/joint_positions` shows one"),
    ("rosrun rviz rviz", "RViz, empty: File, Open Config; the rig's is `src/leap_rig/rviz/rig.rviz`"),
)


def page() -> str:
    """Returns the page."""
    parts = [
        markdown.generated(
            "Commands",
            "the Makefile and the programs",
            "Programs start with `rosrun PACKAGE PROGRAM`, after `source devel/setup.bash`; most have "
            "`--help`. Nodes get their parameters from the [launch files](launch.md) that start them.",
        ),
        "## make\n",
        markdown.table(["command", "effect"], [[f"`make {name}`", what] for name, what in targets().items()]),
    ]
    parts += ["## Lines of the 2019 report\n", _as_typed(), "## ROS's own, beside a running rig\n"]
    parts.append(markdown.table(["command", "shows"], [[f"`{typed}`", shows] for typed, shows in ROS_TOOLS]))
    name = ""
    rows: list[list[str]] = []
    for file in sorted(sources.ROOT.glob("src/**/scripts/*.py"), key=sources.inside):
        if sources.package(file) != name:
            if rows:
                parts.append(markdown.table(["program", "effect"], rows))
            name, rows = sources.package(file), []
            parts.append(f"## {name}\n")
        doc = ast.get_docstring(ast.parse(file.read_text())) or ""
        rows.append([markdown.code(file.name), markdown.text(doc.split("\n\n")[0])])
    parts.append(markdown.table(["program", "effect"], rows))
    return "\n".join(parts)


def _as_typed() -> str:
    says = (
        "As typed they mean the real devices, but for the demo. Nothing simulates in place of a device that does not "
        "answer; a [calibration](../handbook/calibration.md) says whether it was simulated.\n"
    )
    head = ["chapter", "line", "starts", "without an answer of the device", "without hardware add"]
    rows = [[line.chapter, f"`{line.typed}`", line.starts, line.missing, line.without] for line in AS_TYPED]
    return f"{says}\n{markdown.table(head, rows)}"


def targets() -> dict[str, str]:
    """Returns the commands of the Makefile and what they do."""
    return dict(re.findall(r"^([a-z0-9-]+):.*?## (.*)$", (sources.ROOT / "Makefile").read_text(), re.MULTILINE))

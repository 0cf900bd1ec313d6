"""The private parameters of the nodes, for the page of parameters."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tools.reference import markdown, schemas, sources


@dataclass(frozen=True)
class Node:
    """The private parameters of a node.

    Attributes:
        schemas: `module:Class` by the section that it checks; an empty section is the node itself.
        files: yaml files, `package/config/file.yaml`, by the section that a launch file loads them into."""

    schemas: Mapping[str, str]
    files: Mapping[str, tuple[str, ...]]


APRILTAG_FILES = ("apriltag_ros/config/settings.yaml", "apriltag_ros/config/tags.yaml")
VIEW = {"view": ("vision/config/stereo_view.yaml",)}
CALIBRATIONS = {
    "rgb_calibration": ("vision/config/xtion_rgb.yaml",),
    "depth_calibration": ("vision/config/xtion_depth.yaml",),
}

NODES: dict[str, Node] = {
    "apriltag_ros/apriltag_ros_continuous_node.py": Node(
        {"": "apriltag_ros.settings:DetectorSettings"}, {"": APRILTAG_FILES}
    ),
    "apriltag_ros/apriltag_ros_single_image_server_node.py": Node(
        {"": "apriltag_ros.settings:DetectorSettings"}, {"": APRILTAG_FILES}
    ),
    "grasping/collect.py": Node(
        {"": "grasping.lab.ros.collection_setup:CollectionConfig"},
        {
            "": ("grasping/config/collection.yaml",),
            "ggcnn": ("grasping/config/ggcnn.yaml",),
            "ggcnn/tool": ("grasping/config/tool_pose.yaml",),
        },
    ),  # fmt: skip
    "grasping/ggcnn.py": Node({}, {"": ("grasping/config/ggcnn.yaml",), "tool": ("grasping/config/tool_pose.yaml",)}),
    "grasping/grasp_execution.py": Node(
        {}, {"": ("grasping/config/execution.yaml",), "tool_pose": ("grasping/config/tool_pose.yaml",)}
    ),
    "leap_hand/leap_hand_node.py": Node({"": "leap_hand.config:NodeConfig"}, {}),
    "leap_rig/leap_teleop.py": Node(
        {
            "": "leap_rig.teleop_config:LeapTeleopConfig",
            "driver": "leap_motion.ros.parameters:DriverConfig",
            "hand": "leap_hand.config:NodeConfig",
        },
        {},
    ),
    "leap_kuka/arm_choice_node.py": Node({"": "leap_kuka.ros.arm_choice_node:ArmChoiceConfig"}, {}),
    "leap_motion/leap_driver.py": Node({"": "leap_motion.ros.parameters:DriverConfig"}, {}),
    "leap_motion/visualizer.py": Node({"": "leap_motion.ros.parameters:VisualizerConfig"}, {}),
    "reflex/reflex_takktile_driver.py": Node(
        {"": "reflex.ros.parameters:ReflexDriverConfig"}, {"": ("reflex/config/reflex_takktile.yaml",)}
    ),
    "leap_rig/ros2_bridge.py": Node({"": "leap_rig.ros2.config:Ros2BridgeConfig"}, {}),
    "leap_rig/cockpit_node.py": Node({"": "leap_rig.cockpit.settings:CockpitConfig"}, {}),
    "leap_rig/operator_view_node.py": Node({"": "leap_rig.operator.view:OperatorViewConfig"}, {}),
    "leap_rig/tutorial.py": Node({"": "leap_rig.operator.ros.tutorial_node:TutorialConfig"}, {}),
    "rig_simulation/camera_node.py": Node(
        {"": "rig_simulation.node_parameters:CameraConfig"},
        {"": ("rig_simulation/config/camera.yaml",), **CALIBRATIONS},
    ),
    "rig_simulation/camera_truth_node.py": Node({"": "rig_simulation.node_parameters:WorldConfig"}, {}),
    "rig_simulation/operator_node.py": Node({"": "rig_simulation.node_parameters:OperatorConfig"}, {}),
    "rig_simulation/simulation_node.py": Node({"": "rig_simulation.node_parameters:SimulationConfig"}, {}),
    "vision/camera_frames_node.py": Node({}, {"": ("vision/config/camera_frames.yaml",)}),
    "vision/camera_place_node.py": Node({"": "vision.calibration.record:CameraPoseConfig"}, {}),
    "vision/camera_watchdog_node.py": Node({}, {"": ("vision/config/camera_watchdog.yaml",)}),
    "vision/plane_pose_node.py": Node(
        {"": "vision.camera.registration:PairsConfig"},
        {
            "detector": ("vision/config/settings.yaml", "vision/config/tags.yaml"),
            "panel": ("vision/config/panel.yaml",),
            "plane_pose": ("vision/config/plane_pose.yaml",),
        },
    ),  # fmt: skip
    "vision/register_rgbd_node.py": Node({"": "vision.camera.registration:PairsConfig"}, {}),
    "vision/register_rgbd_start.py": Node({"": "vision.camera.registration:PairsConfig"}, {}),
    "vision/stereo_view_node.py": Node({"": "vision.stereo.view:WindowConfig"}, VIEW),
    "vision/stereo_web_node.py": Node({"web": "vision.stereo.view:WebConfig"}, VIEW),
    "vision/xtion_node.py": Node(
        {}, {"": ("vision/config/xtion.yaml",), "frames": ("vision/config/camera_frames.yaml",), **CALIBRATIONS}
    ),
}
"""By the node's program, `package/program.py`. A test compares this with the launch files and the code."""


def of_package(package: str) -> list[str]:
    """Returns the parts of the page about the nodes of a package; nodes with the same parameters share one."""
    programs: dict[str, list[str]] = defaultdict(list)
    for program in NODES:
        if program.split("/")[0] == package:
            programs[_section(program)].append(program.split("/")[1])
    return [f"### {', '.join(names)}\n\n{text}" for text, names in programs.items()]


def keys(program: str) -> set[str]:
    """Returns the names of all private parameters of a node, `section/key`."""
    node = NODES[program]
    own = {_name(where, key.name) for where, schema in node.schemas.items() for key in schemas.keys_of(schema)}
    loaded = {name for where, files in node.files.items() for file in files for name in _names(where, _values(file))}
    return own | loaded


def _section(program: str) -> str:
    node = NODES[program]
    parts = []
    if node.files:
        loaded = (
            f"{', '.join(markdown.code(file) for file in files)}{f' as `~{where}`' if where else ''}"
            for where, files in node.files.items()
        )
        parts.append(f"From {'; '.join(loaded)}.\n")
    rows = []
    for where, schema in node.schemas.items():
        in_files = {key for file in node.files.get(where, ()) for key in _values(file)}
        left = (key for key in schemas.keys_of(schema) if key.name not in in_files)
        rows += [schemas.row(key, f"~{_name(where, key.name)}", {}) for key in left]
    if rows:
        parts.append(schemas.table("private parameter", rows))
    return "\n".join(parts)


def _names(where: str, values: Mapping[str, Any]) -> Iterator[str]:
    for key, value in values.items():
        yield _name(where, key)
        if isinstance(value, Mapping):
            yield from _names(_name(where, key), value)


def _name(where: str, key: str) -> str:
    return f"{where}/{key}" if where else key


def _values(file: str) -> dict[str, Any]:
    path: Path = next(sources.ROOT.glob(f"src/**/{file}"))
    values: dict[str, Any] = yaml.safe_load(path.read_text())
    return values

"""The page of parameters: each yaml file with the schema that checks it, and the private parameters of the nodes."""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Tuple

import yaml

from tools.reference import markdown, nodes, schemas, sources


@dataclass(frozen=True)
class Part:
    """A mapping in a yaml file and its schema.

    Attributes:
        schema: `module:Class`.
        path: keys that lead to the mapping; none for the whole file.
        above: whether the file holds only some of the keys: it stands above another one, or a node is given the rest.
    """

    schema: str
    path: tuple[str, ...] = ()
    above: bool = False


SCENE = "rig_simulation.world.scene"
OBJECTS = {"cup": "Cup", "box": "Cuboid", "ball": "Ball", "cylinder": "Cylinder", "bottle": "Bottle"}

GGCNN = {
    "input": "settings:InputConfig",
    "network": "settings:NetworkConfig",
    "crop": "view:CropConfig",
    "table": "view:TableConfig",
    "peaks": "settings:PeaksConfig",
    "averaging": "tracking:AveragingConfig",
    "tracking": "tracking:TrackingConfig",
    "approach": "projection:ApproachConfig",
    "limits": "tool_pose:LimitsConfig",
    "reach": "tool_pose:ReachConfig",
}

SCHEMAS: dict[str, tuple[Part, ...]] = {
    "kuka_control/config/kuka_params_rt.yaml": (Part("kuka_control.model.config:RealTimeConfig"),),
    "kuka_control/config/kuka_params_ptp.yaml": (Part("kuka_control.model.config:PtpConfig"),),
    "kuka_control/config/arm_of_two.yaml": (Part("kuka_control.model.config:RealTimeConfig", above=True),),
    "kuka_control/config/two_simulated_arms.yaml": (Part("kuka_control.model.config:RealTimeConfig", above=True),),
    "kuka_control/config/ceiling.yaml": (Part("kuka_control.model.config:RealTimeConfig", above=True),),
    "kuka_control/config/marker_ring.yaml": (Part("kuka_control.model.config:RealTimeConfig", above=True),),
    "kuka_control/config/wall.yaml": (Part("kuka_control.model.config:RealTimeConfig", above=True),),
    "kuka_control/config/dh_parameters_example.yaml": (Part("kuka_control.model.config:DhDeviations"),),
    "leap_kuka/config/leap_params.yaml": (Part("leap_kuka.config:LeapConfig"),),
    "leap_kuka/config/webcam.yaml": (Part("leap_kuka.config:LeapConfig", above=True),),
    "leap_kuka/config/relative_device.yaml": (Part("leap_kuka.config:LeapConfig", above=True),),
    "leap_kuka/config/relative_pinch.yaml": (Part("leap_kuka.config:LeapConfig", above=True),),
    "leap_kuka/config/relative_policy.yaml": (Part("leap_kuka.config:LeapConfig", above=True),),
    "leap_kuka/config/relative_two_hands.yaml": (Part("leap_kuka.config:LeapConfig", above=True),),
    "leap_kuka/config/relative_arm_choice.yaml": (Part("leap_kuka.config:LeapConfig", above=True),),
    "grasping/config/collection.yaml": (
        Part("grasping.lab.ros.collection_setup:CollectionConfig", above=True),
        Part("grasping.lab.dataset.frame_buffer:FrameBufferConfig", ("frames",)),
        Part("grasping.execution.grasp_watch:GraspWatchConfig", ("watch",)),
    ),
    "grasping/config/execution.yaml": (
        Part("grasping.execution.execution:ExecutionConfig"),
        Part("grasping.execution.grasp_watch:GraspWatchConfig", ("watch",)),
    ),
    "grasping/config/ggcnn.yaml": (
        Part("grasping.pipeline.settings:GgcnnConfig"),
        *(Part(f"grasping.pipeline.{schema}", (section,)) for section, schema in GGCNN.items()),
    ),
    "grasping/config/tool_pose.yaml": (Part("grasping.pipeline.tool_pose:ToolPoseConfig"),),
    "leap_hand/config/leap_hand.yaml": (Part("leap_hand.config:HandConfig"),),
    "leap_hand/config/full_grip.yaml": (Part("leap_hand.config:HandConfig", above=True),),
    "leap_hand/config/firm_grip.yaml": (Part("leap_hand.config:HandConfig", above=True),),
    "reflex/config/reflex_takktile.yaml": (Part("reflex.ros.parameters:ReflexDriverConfig", above=True),),
    "apriltag_ros/config/settings.yaml": (Part("apriltag_ros.settings:DetectorSettings", above=True),),
    "vision/config/settings.yaml": (Part("apriltag_ros.settings:DetectorSettings", above=True),),
    "vision/config/panel.yaml": (Part("vision.marker_board.board:MarkerBoardConfig"),),
    "vision/config/panel_single.yaml": (Part("vision.marker_board.board:MarkerBoardConfig"),),
    "vision/config/camera_calibration.yaml": (Part("vision.calibration.acceptance:CalibrationConfig"),),
    "vision/config/calibration_views.yaml": (Part("vision.calibration.view_planner:ViewsConfig"),),
    "vision/config/camera_frames.yaml": (Part("vision.camera.frames:CameraFramesConfig"),),
    "vision/config/camera_watchdog.yaml": (Part("vision.camera.stream_watch:WatchConfig"),),
    "vision/config/plane_pose.yaml": (Part("vision.marker_board.plane_fit:PlanePoseConfig"),),
    "vision/config/stereo_view.yaml": (Part("vision.stereo.view:StereoViewConfig"),),
    "vision/config/xtion.yaml": (Part("vision.camera.openni_camera:XtionConfig"),),
    "rig_simulation/config/camera.yaml": (
        Part("rig_simulation.node_parameters:CameraConfig"),
        Part("rig_simulation.node_parameters:ColourConfig", ("colour",)),
        Part("rig_simulation.node_parameters:DepthConfig", ("depth",)),
    ),
    "rig_simulation/config/scenes/objects.yaml": (
        Part(f"{SCENE}:Table", ("table",)),
        Part(f"{SCENE}:CameraPose", ("camera",)),
        *(Part(f"{SCENE}:{kind}", ("objects", name)) for name, kind in OBJECTS.items()),
    ),
}
"""Files shown as tables."""

Shown = Dict[Tuple[str, ...], Tuple[str, str, str]]
"""Package, file and value that explain a key, by schema or package, key, range and meaning."""

AS_IT_IS = {
    "apriltag_ros/config/tags.yaml",
    "kuka_control/config/guard_obstacles_example.yaml",
    "kuka_control/config/joint_configurations.yaml",
    "kuka_control/config/two_arms.yaml",
    "reflex/config/finger_calibrate.yaml",
    "reflex/config/tactile_calibrate.yaml",
    "rig_simulation/config/panels/bundle.yaml",
    "rig_simulation/config/panels/single.yaml",
    "rig_simulation/config/scenes/cup.yaml",
    "rig_simulation/config/scenes/empty.yaml",
    "rig_simulation/config/scenes/far.yaml",
    "rig_simulation/config/scenes/grasping.yaml",
    "rig_simulation/config/scenes/scattered.yaml",
    "rig_simulation/config/scenes/two_arms.yaml",
    "rig_simulation/config/scenes/two_cups.yaml",
    "rig_simulation/config/scenes/hand_over.yaml",
    "rig_simulation/config/scenes/wall.yaml",
    "rig_simulation/config/wall_obstacles.yaml",
    "vision/config/tags.yaml",
    "vision/config/tags_single.yaml",
    "vision/config/two_arms_views_left.yaml",
    "vision/config/two_arms_views_right.yaml",
    "vision/config/xtion_depth.yaml",
    "vision/config/xtion_rgb.yaml",
}
"""Files that are only linked: lists, calibrations, third-party formats, obstacles, and files like one with a table."""


def page() -> str:
    """Returns the page."""
    sources.on_path()
    files = sorted(sources.ROOT.glob("src/**/config/**/*.yaml"), key=sources.inside)
    parts = [
        markdown.generated(
            "Parameters",
            "the yaml files and their schemas",
            "Every yaml file with its defaults, and the private parameters of the nodes (`~name`, set by launch files "
            "or as `_name:=value`). A schema checks each file: a value out of range, a missing key and an unknown key "
            "are rejected at start-up, all at once, and nothing moves. In ranges a square bracket includes the limit "
            "and a round one excludes it.",
        )
    ]
    shown: Shown = {}
    packages = {sources.package(file) for file in files} | {program.split("/")[0] for program in nodes.NODES}
    for package in sorted(packages):
        parts.append(f"## {package}\n")
        parts += [_file(file, shown) for file in sorted(files, key=_is_variant) if sources.package(file) == package]
        parts += nodes.of_package(package)
    return "\n".join(parts)


def _is_variant(file: Path) -> bool:
    """Whether a file overrides some values of another one, or repeats its keys for the PTP controller."""
    return "ptp" in file.name or any(part.above for part in SCHEMAS.get(sources.inside(file), ()))


def _file(file: Path, shown: Shown) -> str:
    """Returns the section of a yaml file; keys that another file explains are only named."""
    words = file.read_text()
    name = str(file.relative_to(file.parents[len(file.parts) - 2 - file.parts.index("config")]))
    head = _head(words)
    parts = [f"### {name}\n", f"[{sources.inside(file)}](../../{file.relative_to(sources.ROOT)})"]
    parts[-1] += f": {markdown.text(head)}\n" if head else "\n"
    found = SCHEMAS.get(sources.inside(file))
    if found is None:
        return "\n".join(parts)
    comments, values = _comments(words), yaml.safe_load(words)
    rest = [k for k in values if not any(not part.path or part.path[0] == k for part in found)]
    rows = [[markdown.code(k), markdown.code(schemas.value(values[k])), "", comments.get((k,), "")] for k in rest]
    explained: dict[str, list[str]] = defaultdict(list)
    for part in found:
        for row in _rows(part, values, comments):
            key, default, *meaning = row
            package = sources.package(file)
            row_of = (key.split(".")[-1], *meaning)
            first = shown.get((part.schema, *row_of)) or shown.get((package, *row_of)) or (package, name, default)
            shown[(part.schema, *row_of)] = shown[(package, *row_of)] = first
            if first[:2] == (package, name):
                if row not in rows:
                    rows.append(row)
            else:
                other = first[1] if first[0] == package else f"{first[0]}/{first[1]}"
                explained[other].append(key if first[2] == default else f"{key} = {default}")
    if rows:
        parts.append(schemas.table("key", rows))
    parts += [f"As in {markdown.code(other)}: {', '.join(keys)}.\n" for other, keys in explained.items()]
    return "\n".join(parts)


def _rows(part: Part, values: Any, comments: dict[tuple[str, ...], str]) -> list[list[str]]:
    for key in part.path:
        values = values[key]
    order = list(values)
    shown = ("objects", "NAME") if part.path[:1] == ("objects",) else part.path
    found = [k for k in schemas.keys_of(part.schema) if k.name in order or not part.above]
    return [
        schemas.row(key, ".".join([*shown, key.name]), values, comments.get((*part.path, key.name), ""))
        for key in sorted(found, key=lambda k: order.index(k.name) if k.name in order else len(order))
    ]


def _head(words: str) -> str:
    lines = []
    for line in words.splitlines():
        if not line.startswith("#") or not line.strip("# "):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


def _comments(words: str) -> dict[tuple[str, ...], str]:
    """Returns the comments after the keys of a yaml file, by their path of keys."""
    found: dict[tuple[str, ...], str] = {}
    above: list[tuple[int, str]] = []
    for line in words.splitlines():
        match = re.match(r"( *)([\w]+):(?:[^#]|(?<! )#)*(?:# (.*))?$", line)
        if not match:
            continue
        indent, key, comment = len(match[1]), match[2], match[3]
        above = [(i, k) for i, k in above if i < indent]
        if comment:
            found[(*(k for _, k in above), key)] = comment
        above.append((indent, key))
    return found

"""The page of parameters: each yaml file beside the schema that checks it."""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tools.reference import markdown, sources


@dataclass(frozen=True)
class Part:
    """A mapping in a yaml file and its schema.

    Attributes:
        schema: `module:Class`.
        path: keys that lead to the mapping; none for the whole file.
        above: whether the file stands above another one and holds only what it changes.
    """

    schema: str
    path: tuple[str, ...] = ()
    above: bool = False


SCENE = "rig_simulation.world.scene"
OBJECTS = {"cup": "Cup", "box": "Box", "ball": "Ball", "cylinder": "Cylinder", "bottle": "Bottle"}

GGCNN = {
    "input": "settings:InputConfig",
    "network": "settings:NetworkConfig",
    "crop": "view:CropConfig",
    "table": "view:TableConfig",
    "peaks": "settings:PeaksConfig",
    "averaging": "tracking:AveragingConfig",
    "tracking": "tracking:TrackingConfig",
    "approach": "surface:ApproachConfig",
    "limits": "limits:LimitsConfig",
    "reach": "reach:ReachConfig",
}

SCHEMAS: dict[str, tuple[Part, ...]] = {
    "kuka_control/config/kuka_params_rt.yaml": (Part("kuka_control.config:RealTimeConfig"),),
    "kuka_control/config/kuka_params_ptp.yaml": (Part("kuka_control.config:PtpConfig"),),
    "kuka_control/config/ceiling.yaml": (Part("kuka_control.config:RealTimeConfig", above=True),),
    "kuka_control/config/wall.yaml": (Part("kuka_control.config:RealTimeConfig", above=True),),
    "kuka_control/config/dh_parameters_example.yaml": (Part("kuka_control.kinematics.dh:DhDeviations"),),
    "leap_kuka/config/leap_params.yaml": (Part("leap_kuka.config:LeapConfig"),),
    "grasping/config/collection.yaml": (
        Part("grasping.dataset.frame_buffer:FrameBufferConfig", ("frames",)),
        Part("grasping.dataset.grasp_watch:GraspWatchConfig", ("watch",)),
    ),
    "grasping/config/execution.yaml": (
        Part("grasping.execution:ExecutionConfig"),
        Part("grasping.dataset.grasp_watch:GraspWatchConfig", ("watch",)),
    ),
    "grasping/config/ggcnn.yaml": (
        Part("grasping.settings:GgcnnConfig"),
        *(Part(f"grasping.{schema}", (section,)) for section, schema in GGCNN.items()),
    ),
    "grasping/config/tool_pose.yaml": (Part("grasping.tool_pose:ToolPoseConfig"),),
    "leap_hand/config/leap_hand.yaml": (Part("leap_hand.config:HandConfig"),),
    "leap_hand/config/full_grip.yaml": (Part("leap_hand.config:HandConfig", above=True),),
    "reflex/config/reflex_takktile.yaml": (Part("reflex.settings:Settings"),),
    "reflex/config/finger_calibrate.yaml": (Part("reflex.calibration:FingerZeros"),),
    "reflex/config/tactile_calibrate.yaml": (Part("reflex.calibration:TactileOffsets"),),
    "apriltag_ros/config/settings.yaml": (Part("apriltag_ros.settings:DetectorSettings"),),
    "vision/config/settings.yaml": (Part("apriltag_ros.settings:DetectorSettings"),),
    "vision/config/panel.yaml": (Part("vision.panel:PanelConfig"),),
    "vision/config/panel_single.yaml": (Part("vision.panel:PanelConfig"),),
    "vision/config/camera_calibration.yaml": (Part("vision.calibration:CalibrationConfig"),),
    "vision/config/calibration_views.yaml": (Part("vision.calibration_views:ViewsConfig"),),
    "vision/config/camera_frames.yaml": (Part("vision.camera_frames:CameraFramesConfig"),),
    "vision/config/camera_watchdog.yaml": (Part("vision.stream_watch:WatchConfig"),),
    "vision/config/plane_pose.yaml": (Part("vision.plane_fit:PlanePoseConfig"),),
    "vision/config/stereo_view.yaml": (Part("vision.stereo_view_config:StereoViewConfig"),),
    "vision/config/xtion.yaml": (Part("vision.openni_camera:XtionConfig"),),
    "rig_simulation/config/camera.yaml": (
        Part("rig_simulation.camera.config:ColourConfig", ("colour",)),
        Part("rig_simulation.camera.config:DepthConfig", ("depth",)),
    ),
    "rig_simulation/config/scenes/objects.yaml": (
        Part(f"{SCENE}:Table", ("table",)),
        Part(f"{SCENE}:CameraPlace", ("camera",)),
        *(Part(f"{SCENE}:{kind}", ("objects", name)) for name, kind in OBJECTS.items()),
    ),
}
"""What the page shows as tables."""

AS_IT_IS = {
    "apriltag_ros/config/tags.yaml",
    "kuka_control/config/joint_configurations.yaml",
    "rig_simulation/config/panels/bundle.yaml",
    "rig_simulation/config/panels/single.yaml",
    "rig_simulation/config/scenes/cup.yaml",
    "rig_simulation/config/scenes/empty.yaml",
    "rig_simulation/config/scenes/far.yaml",
    "rig_simulation/config/scenes/grasping.yaml",
    "rig_simulation/config/scenes/scattered.yaml",
    "vision/config/tags.yaml",
    "vision/config/tags_single.yaml",
    "vision/config/xtion_depth.yaml",
    "vision/config/xtion_rgb.yaml",
}
"""Lists, names of one's own, formats of others, and scenes that repeat the keys of objects.yaml."""


def page() -> str:
    """Returns the page."""
    sources.on_path()
    files = sorted(sources.ROOT.glob("src/**/config/**/*.yaml"), key=sources.inside)
    parts = [
        markdown.generated(
            "Parameters",
            "the yaml files and their schemas",
            "Every yaml file of every package with its defaults. What is checked is the schema beside it: a value out "
            "of range, a missing key and an unknown key are refused with one sentence each, and nothing moves.\n\n"
            "In intervals a square bracket includes the limit and a round one does not.",
        )
    ]
    name = ""
    for file in files:
        if sources.package(file) != name:
            name = sources.package(file)
            parts.append(f"## {name}\n")
        parts.append(_file(file))
    return "\n".join(parts)


def _file(file: Path) -> str:
    words = file.read_text()
    parts = [f"### {file.relative_to(file.parents[len(file.parts) - 2 - file.parts.index('config')])}\n"]
    head = _head(words)
    parts.append(f"{sources.link(file)}{': ' + markdown.text(head) if head else ''}\n")
    schemas = SCHEMAS.get(sources.inside(file))
    if schemas is None:
        body = re.sub(r"\A(#.*\n)+\n*", "", words)
        return "\n".join([*parts, f"```yaml\n{body.rstrip()}\n```\n"])
    comments = _comments(words)
    rest = [k for k in yaml.safe_load(words) if not any(not part.path or part.path[0] == k for part in schemas)]
    if rest:
        values = yaml.safe_load(words)
        rows = [[markdown.code(k), markdown.code(_value(values[k])), comments.get((k,), "")] for k in rest]
        parts.append(markdown.table(["key", "default", "meaning"], rows))
    for part in schemas:
        parts.append(_table(part, yaml.safe_load(words), comments))
    return "\n".join(parts)


def _table(part: Part, values: Any, comments: dict[tuple[str, ...], str]) -> str:
    from common.config import keys

    module, name = part.schema.split(":")
    for key in part.path:
        values = values[key]
    order = list(values)
    found = [k for k in keys(getattr(importlib.import_module(module), name)) if k.name in order or not part.above]
    rows = [
        [
            markdown.code(".".join([*part.path, key.name])),
            markdown.code(_value(values[key.name])) if key.name in order else "",
            key.type + (": " + key.range if key.type == "one of" else ""),
            "" if key.type == "one of" else key.range,
            key.unit,
            markdown.text(key.meaning or comments.get((*part.path, key.name), "")),
        ]
        for key in sorted(found, key=lambda k: order.index(k.name) if k.name in order else len(order))
    ]
    return markdown.table(["key", "default", "type", "range", "unit", "meaning"], rows)


def _value(value: Any) -> str:
    return yaml.safe_dump(value, default_flow_style=True, width=1000, allow_unicode=True).replace("...", "").strip()


def _head(words: str) -> str:
    """Returns the comment at the top of a file, up to its first empty line."""
    lines = []
    for line in words.splitlines():
        if not line.startswith("#") or not line.strip("# "):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


def _comments(words: str) -> dict[tuple[str, ...], str]:
    """Returns the comments behind the keys of a yaml, by the keys that lead there."""
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

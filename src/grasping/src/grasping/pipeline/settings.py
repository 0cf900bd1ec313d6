"""The schema of ggcnn.yaml, section by section, and the settings that are made of it.

A fingerprint of what decides whether two episodes belong together is made of `rig_configuration`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_type_hints

import numpy as np

from common.camera_model import CameraModel
from common.config import choice, flag, integer, number, parse_part, text
from common.errors import ConfigError
from grasping.network.depth_image import TABLE, VIEWS
from grasping.network.maps import Smoothing
from grasping.network.networks import NETWORKS, PRECISIONS
from grasping.pipeline.pipeline import PipelineSettings
from grasping.pipeline.projection import ApproachConfig
from grasping.pipeline.tool_pose import LimitsConfig, ReachConfig, ToolPoseConfig, grasp_in_tool
from grasping.pipeline.tracking import AveragingConfig, TrackingConfig
from grasping.pipeline.view import CameraView, CropConfig, TableConfig, TableView
from grasping.poses.taste_file import Origin

ANY, LISTED = "any", "listed"
AUTO, MUST, NEVER = "auto", "must", "never"


@dataclass(frozen=True)
class InputConfig:
    """The camera's topics."""

    depth_topic: str = text(doc="depth images, 16UC1 in mm or 32FC1 in m")
    info_topic: str = text(doc="description of the camera that takes them")
    max_age: float = number("s", above=0.0, high=60.0, doc="an image older than this, or as far ahead, is refused")
    silence: float = number("s", above=0.0, high=60.0, doc="without an image for this long the camera counts as silent")


@dataclass(frozen=True)
class NetworkConfig:
    """Which network, and how it runs."""

    kind: str = choice(ANY, *NETWORKS, doc="what the weights must be of; any: what the file says")
    weights: str = text(doc="weight file: a name in the package's folder weights, or an absolute path")
    sha256: str = text(doc="hash of the file; listed: as SHA256SUMS beside it says; any: unchecked")
    threads: int = integer(low=1, high=64, doc="processors that the network may use")
    precision: str = choice(*PRECISIONS, doc="of its convolutions; bfloat16 is slow where the processor lacks it")


@dataclass(frozen=True)
class PeaksConfig:
    """How grasps are taken out of the maps."""

    count: int = integer(low=1, high=50, doc="most grasps in an image")
    distance: int = integer("px", low=1, high=100, doc="between two grasps in the network's image")
    threshold: float = number(low=0.0, high=1.0, doc="lowest smoothed quality")
    quality_sigma: float = number("px", low=0.0, high=20.0, doc="standard deviation of the quality's blur")
    angle_sigma: float = number("px", low=0.0, high=20.0, doc="of the angle's, by its cosine and sine")
    width_sigma: float = number("px", low=0.0, high=20.0, doc="of the opening's")


@dataclass(frozen=True)
class GgcnnConfig:
    """What stands beside the sections."""

    view: str = choice(*VIEWS, doc="the camera's own image, or one from above the table")
    refine: bool = flag(doc="of the grasps that a network of lifts offers, prefer those that the operator would take")
    refinement_weights: str = text(doc="its weight file: a name in the package's folder weights, or an absolute path")
    refinement_kind: str = text(
        doc="kind of object that is grasped, of those in that file; empty: its only one; may be changed while the node "
        "runs",
        empty=True,
    )
    lifts: str = choice(
        AUTO, MUST, NEVER, doc="whether a network of lifts chooses tilted grasps: where its file fits, must, or never"
    )
    lift_weights: str = text(
        doc="its weight file: a name in the package's folder weights, or an absolute path; empty: the hand's own",
        empty=True,
    )
    max_tilt: float = number("deg", low=0.0, high=45.0, doc="largest tilt of its grasps from straight down")

    def faults(self) -> list[str]:
        without = self.refine and self.lifts == NEVER
        return ["lifts is never, but refine: true chooses among the grasps of that network."] if without else []


@dataclass(frozen=True)
class GgcnnSettings:
    """The whole configuration: what stands beside the sections, and each section by its name."""

    main: GgcnnConfig
    input: InputConfig
    network: NetworkConfig
    crop: CropConfig
    table: TableConfig
    peaks: PeaksConfig
    averaging: AveragingConfig
    tracking: TrackingConfig
    approach: ApproachConfig
    limits: LimitsConfig
    reach: ReachConfig
    tool: ToolPoseConfig

    def views(self) -> CameraView | TableView:
        """Returns what makes the network's image."""
        return TableView(self.crop, self.table) if self.main.view == TABLE else CameraView(self.crop)

    def steps(self, up: np.ndarray) -> PipelineSettings:
        """Returns the settings of the steps behind the view; `up` is the vertical in kuka/base_frame, shape (3,)."""
        p, later = self.peaks, (self.averaging, self.tracking, self.approach, self.limits, self.tool)
        smoothing = Smoothing(p.quality_sigma, p.angle_sigma, p.width_sigma)
        tilt = math.radians(self.main.max_tilt)
        return PipelineSettings(smoothing, p.count, p.distance, p.threshold, *later, up, self.network.precision, tilt)


SECTIONS = {name: schema for name, schema in get_type_hints(GgcnnSettings).items() if name != "main"}


def settings_from(values: Mapping[str, Any], prefix: str = "") -> GgcnnSettings:
    """Returns the configuration in a mapping of ggcnn.yaml, with tool_pose.yaml as its section `tool`. Raises
    ConfigError with the faults of all sections.
    """
    faults: list[str] = []
    read: dict[str, Any] = {"main": parse_part(GgcnnConfig, values, prefix, faults, others=SECTIONS)}
    for name, schema in SECTIONS.items():
        read[name] = parse_part(schema, values.get(name, {}), f"{prefix}{name}/", faults)
    if faults:
        raise ConfigError(faults)
    return GgcnnSettings(**read)


def overlaid(values: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a mapping with changes to it, section by section."""
    result = {**values, **changes}
    for key in values.keys() & changes.keys():
        if isinstance(values[key], Mapping) and isinstance(changes[key], Mapping):
            result[key] = overlaid(values[key], changes[key])
    return result


def sentences(settings: GgcnnSettings) -> list[str]:
    """Returns the effective settings, one line a section."""
    lines = []
    for name in ("main", *SECTIONS):
        section = getattr(settings, name)
        values = ", ".join(f"{f.name}={getattr(section, f.name)}" for f in dataclasses.fields(section))
        lines.append(values if name == "main" else f"{name}: {values}")
    return lines


def rig_configuration(
    kuka: dict[str, Any],
    T_flange_tool: np.ndarray,
    T_tool_grasp: np.ndarray,
    camera: CameraModel,
    T_base_camera: np.ndarray,
    settings: GgcnnSettings,
    weights: str,
) -> dict[str, Any]:
    """Returns the configuration as JSON can hold it; poses have shape (4, 4) [m]. `kuka`: robot, flange, mounting and
    file of calibrated parameters of the arm; `weights`: SHA-256 of the network's weight file.
    """
    digits = 3  # decimals of the camera pose: a millimetre and a milliradian; two live calibrations differ by more
    matrices = {key: getattr(camera, key).tolist() for key in "KDRP"}
    # Adding 0 turns -0.0 into 0.0, which would be another text.
    return {
        "kuka": kuka,
        "T_flange_tool": T_flange_tool.tolist(),
        "camera": {"name": camera.name, "size": [camera.width, camera.height], **matrices},
        "T_base_camera": (np.round(T_base_camera, digits) + 0.0).tolist(),
        **_network_configuration(T_tool_grasp, settings, weights),
    }


def live_origin(settings: GgcnnSettings, weights: str, robot: str | None, lifts: str) -> Origin:
    """Returns this rig as a taste depends on it; `weights`, `lifts`: SHA-256 of the files of GGCNN and of the network
    of lifts; `robot`: None if unknown."""
    found = _network_configuration(grasp_in_tool(settings.tool), settings, weights)
    return Origin.of({**found, "kuka": {"robot": robot}}, lifts)


def _network_configuration(T_tool_grasp: np.ndarray, settings: GgcnnSettings, weights: str) -> dict[str, Any]:
    view = settings.main.view
    return {
        "T_tool_grasp": (np.round(T_tool_grasp, 9) + 0.0).tolist(),
        "view": view,
        "crop": asdict(settings.crop),
        "table": asdict(settings.table) if view == TABLE else None,
        "weights": weights,
    }

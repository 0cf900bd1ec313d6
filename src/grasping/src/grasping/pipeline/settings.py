"""The schema of ggcnn.yaml, section by section, and the settings that are made of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.config import choice, flag, integer, number, parse_part, text
from common.errors import ConfigError
from grasping.network.depth_image import TABLE, VIEWS
from grasping.network.maps import Smoothing
from grasping.network.networks import NETWORKS
from grasping.pipeline.limits import LimitsConfig
from grasping.pipeline.pipeline import PipelineSettings
from grasping.pipeline.reach import ReachConfig
from grasping.pipeline.surface import ApproachConfig
from grasping.pipeline.tool_pose import ToolPoseConfig
from grasping.pipeline.tracking import AveragingConfig, TrackingConfig
from grasping.pipeline.view import CameraView, CropConfig, TableConfig, TableView

ANY, LISTED = "any", "listed"


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
    refine: bool = flag(doc="put the refinement network, learned from the operator, behind the first")
    refinement_weights: str = text(doc="its weight file: a name in the package's folder weights, or an absolute path")


SECTIONS = {
    "input": InputConfig,
    "network": NetworkConfig,
    "crop": CropConfig,
    "table": TableConfig,
    "peaks": PeaksConfig,
    "averaging": AveragingConfig,
    "tracking": TrackingConfig,
    "approach": ApproachConfig,
    "limits": LimitsConfig,
    "reach": ReachConfig,
    "tool": ToolPoseConfig,
}


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
        p = self.peaks
        return PipelineSettings(
            Smoothing(p.quality_sigma, p.angle_sigma, p.width_sigma),
            p.count,
            p.distance,
            p.threshold,
            self.averaging,
            self.tracking,
            self.approach,
            self.limits,
            self.tool,
            up,
        )


def settings_from(values: Mapping[str, Any], prefix: str = "") -> GgcnnSettings:
    """Returns the configuration that a mapping of ggcnn.yaml, with tool_pose.yaml as its section `tool`, holds.

    Raises:
        ConfigError: with the faults of all sections.
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
    result = dict(values)
    for key, change in changes.items():
        below = result.get(key)
        if isinstance(below, Mapping) and isinstance(change, Mapping):
            result[key] = overlaid(below, change)
        else:
            result[key] = change
    return result


def sentences(settings: GgcnnSettings) -> list[str]:
    """Returns the effective settings, one line a section."""
    lines = []
    for name in ("main", *SECTIONS):
        section = getattr(settings, name)
        values = ", ".join(f"{f.name}={getattr(section, f.name)}" for f in dataclasses.fields(section))
        lines.append(values if name == "main" else f"{name}: {values}")
    return lines

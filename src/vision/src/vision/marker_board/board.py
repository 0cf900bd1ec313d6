"""The marker board on the arm: its pose on the flange by the dimensions of its drawing, and its tags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from apriltag_ros.settings import TAG_KEYS, TagTarget, targets
from common.config import number, text, vector
from common.errors import ConfigError
from common.frames import frame_name
from common.poses import inverse, pose
from common.rotations import rotation_from_zyx


@dataclass(frozen=True)
class MarkerBoardConfig:
    """The schema of panel.yaml."""

    frame: str = text(doc="name of the tag or bundle in tags.yaml", taken_as=frame_name)
    rotation: np.ndarray = vector(3, "deg", low=-360.0, high=360.0, doc="rotations about z, y, x from tag to flange")
    translation: np.ndarray = vector(3, "m", low=-1.0, high=1.0, doc="from tag to flange, along the flange's axes")
    plate: float = number("m", above=0.0, high=1.0, doc="edge of the plate round the tag")

    @property
    def T_tag_flange(self) -> np.ndarray:
        """The flange in the frame of the tag, shape (4, 4) [m]."""
        return pose(rotation_from_zyx(*np.radians(self.rotation))) @ pose(p=self.translation)

    @property
    def T_flange_tag(self) -> np.ndarray:
        """The tag in the frame of the flange, shape (4, 4) [m]."""
        return inverse(self.T_tag_flange)


def board_target(detector: Mapping, name: str, frame: str) -> TagTarget:
    """Returns the tag or bundle `frame` in the parameters of the detector `name`; raises ConfigError if it has none."""
    found = {target.name: target for target in targets({key: detector.get(key) for key in TAG_KEYS})}
    if frame in found:
        return found[frame]
    names = ", ".join(found)
    raise ConfigError([f"{name} detects {names}, but not the marker board {frame}: use its tags.yaml and panel.yaml."])

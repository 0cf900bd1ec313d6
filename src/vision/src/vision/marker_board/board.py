"""The marker board on the arm: its pose on the flange, by the dimensions of its drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import number, text, vector
from common.poses import inverse, pose
from common.rotations import rotation_from_zyx


@dataclass(frozen=True)
class MarkerBoardConfig:
    """The schema of panel.yaml."""

    frame: str = text(doc="name of the tag or bundle in tags.yaml")
    rotation: np.ndarray = vector(
        3, "deg", low=-360.0, high=360.0, doc="rotations about z, y, x from the tag to the flange"
    )
    translation: np.ndarray = vector(
        3, "m", low=-1.0, high=1.0, doc="from the tag to the flange, along the flange's axes"
    )
    plate: float = number("m", above=0.0, high=1.0, doc="edge of the plate round the tag")

    @property
    def T_tag_flange(self) -> np.ndarray:
        """The flange in the frame of the tag, shape (4, 4) [m]."""
        return pose(rotation_from_zyx(*np.radians(self.rotation))) @ pose(p=self.translation)

    @property
    def T_flange_tag(self) -> np.ndarray:
        """The tag in the frame of the flange, shape (4, 4) [m]."""
        return inverse(self.T_tag_flange)

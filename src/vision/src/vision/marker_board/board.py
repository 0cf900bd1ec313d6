"""The marker panel on the arm: where the flange stands as seen from the tag, in the numbers of the panel's drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import number, text, vector
from common.poses import inverse, pose
from common.rotations import rotation_from_zyx


@dataclass(frozen=True)
class PanelConfig:
    """The schema of panel.yaml."""

    frame: str = text(doc="name of the tag or bundle in tags.yaml")
    rotation: np.ndarray = vector(
        3, "deg", low=-360.0, high=360.0, doc="turns about z, y, x from the tag to the flange"
    )
    translation: np.ndarray = vector(
        3, "m", low=-1.0, high=1.0, doc="from the tag to the flange, along the flange's axes"
    )
    plate: float = number("m", above=0.0, high=1.0, doc="edge of the plate round the tag")

    @property
    def T_tag_flange(self) -> np.ndarray:
        """The flange seen from the tag, shape (4, 4) [m]."""
        R = rotation_from_zyx(*np.radians(self.rotation))
        return pose(R) @ pose(p=self.translation)

    @property
    def T_flange_tag(self) -> np.ndarray:
        """The tag seen from the flange, shape (4, 4) [m]."""
        return inverse(self.T_tag_flange)

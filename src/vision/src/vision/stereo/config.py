"""The settings of the view for the headset."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, flag, integer, number


@dataclass(frozen=True)
class StereoViewConfig:
    """The schema of stereo_view.yaml."""

    lens: str = choice("dk2", "none", doc="lens to undo: of the Rift DK2, or none for a viewer that undoes its own")
    chromatic: bool = flag(doc="undo also that the lens bends each colour differently")
    magnification: float = number(above=0.0, high=4.0, doc="1 shows true angles, larger values a larger picture")
    depth: bool = flag(doc="give each eye its own view by the depth picture; false: the same picture twice")
    eye_distance: float = number("m", low=0.05, high=0.08, doc="distance between the eyes of the person")
    flat_distance: float = number("m", low=0.3, doc="where the picture seems to be while there is no depth")
    nearest: float = number("m", low=0.1, doc="what is nearer is shown at this distance")
    depth_gap: float = number("s", low=0.0, high=1.0, doc="farthest apart in time that picture and depth may be")
    age_after: float = number("s", low=0.1, high=10.0, doc="age from which a picture is marked with its age")
    jpeg_quality: int = integer("%", low=10, high=100, doc="of the pictures that the web page gets")

    def faults(self) -> list[str]:
        """Returns what no single field can check."""
        if self.nearest > self.flat_distance:
            return [f"nearest is {self.nearest:g} m, but must not be beyond flat_distance, {self.flat_distance:g} m."]
        return []

"""The effects of the camera on its images: the schemas of `colour` and `depth` in camera.yaml.

Sources: reference values of structured-light sensors (Nguyen, Izadi, Lovell 2012; Khoshelham 2011; Boehm 2014) and the
data sheet of the Xtion Pro Live. Each line names the value that disables its effect.
"""

from __future__ import annotations

import dataclasses

from common.config import flag, number


@dataclasses.dataclass(frozen=True)
class ColourConfig:
    """The colour camera."""

    exposure: float = number(low=0.1, high=4.0, doc="factor on the brightness; 1 = as rendered")
    blur: float = number("px", low=0.0, high=5.0, doc="standard deviation of the point spread; 0 = none")
    noise: float = number("grey levels", low=0.0, high=30.0, doc="standard deviation of the noise; 0 = none")


@dataclasses.dataclass(frozen=True)
class DepthConfig:
    """The depth camera: a projector of infrared points and an infrared camera."""

    noise: bool = flag(doc="random error along the axis")
    correlation: float = number("px", low=0.0, high=10.0, doc="reach of the noise over neighbouring pixels; 0 = white")
    edge_jitter: float = number("px", low=0.0, high=5.0, doc="standard deviation of where edges lie; 0 = none")
    quantisation: float = number("px", low=0.0, high=1.0, doc="step of the disparity; 0 = none")
    shadows: bool = flag(doc="no depth where the projector's light does not reach")
    projector_baseline: float = number("m", low=0.01, high=0.3, doc="projector's place to the right of the camera")
    min_range: float = number("m", low=0.1, high=2.0, doc="no depth nearer than this")
    max_range: float = number("m", above=0.5, high=20.0, doc="no depth farther than this")
    max_angle: float = number("deg", above=0.0, high=90.0, doc="no depth where the surface is steeper; 90 = no limit")
    min_signal: float = number(low=0.0, high=1.0, doc="no depth where less light returns; 1 = white, 1 m away; 0 = off")
    dark_return: float = number(low=0.0, high=1.0, doc="fraction of the light that a black surface returns")
    scale_error_sd: float = number(low=0.0, high=0.05, doc="spread of a unit's error of scale; 0 = none")
    warp_sd: float = number("m", low=0.0, high=0.02, doc="spread of a unit's smooth warp at 1 m; 0 = none")

    def faults(self) -> list[str]:
        """Returns faults of several keys together."""
        if self.min_range >= self.max_range:
            return [f"min_range is {self.min_range:g} m, but must be less than max_range, {self.max_range:g} m."]
        return []

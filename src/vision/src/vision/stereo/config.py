"""Parameters of the headset view, of its window and of its web page."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, flag, integer, number, path, text


@dataclass(frozen=True)
class StereoViewConfig:
    """The schema of stereo_view.yaml."""

    lens: str = choice("dk2", "none", doc="lens to correct: the Rift DK2's, or none for a viewer that does it itself")
    chromatic: bool = flag(doc="correct the chromatic aberration of the lens too")
    magnification: float = number(above=0.0, high=4.0, doc="1 shows true angles, larger values a larger image")
    depth: bool = flag(doc="give each eye its own view by the depth image; false: the same image twice")
    eye_distance: float = number("m", low=0.05, high=0.08, doc="distance between the operator's eyes")
    flat_distance: float = number("m", low=0.3, doc="apparent distance of the image while there is no depth")
    nearest: float = number("m", low=0.1, doc="nearer objects are shown at this distance")
    depth_gap: float = number("s", low=0.0, high=1.0, doc="maximum time between colour and depth image")
    age_after: float = number("s", low=0.1, high=10.0, doc="an older image is marked with its age")
    jpeg_quality: int = integer("%", low=10, high=100, doc="quality of the images for the web page")

    def faults(self) -> list[str]:
        """Returns contradictions between fields."""
        if self.nearest > self.flat_distance:
            return [f"nearest is {self.nearest:g} m, but must be at most flat_distance, {self.flat_distance:g} m."]
        return []


@dataclass(frozen=True)
class WindowConfig:
    """Private parameters of the node stereo_view."""

    output: str = text(doc="the display's output; empty: the Rift, or a window without one", absent="", empty=True)


@dataclass(frozen=True)
class WebConfig:
    """Private parameters of the node stereo_web."""

    host: str = text(doc="address to serve on")
    port: int = integer(low=0, high=65535, doc="port; 0: any free one")
    page: str = path(doc="file of the page")
    certificate: str = path(doc="file of a certificate (PEM), for https")
    key: str = path(doc="file of the certificate's key (PEM)")

    def faults(self) -> list[str]:
        """Returns contradictions between fields."""
        if bool(self.certificate) != bool(self.key):
            return ["https needs both certificate and key, but only one is given."]
        return []

"""Private parameters of the nodes beside the yaml files."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, integer, number, path, text
from vision.calibration.record import LIVE

AUTO, STORED = "auto", "stored"


@dataclass(frozen=True)
class PairsConfig:
    """Of the nodes register_rgbd and plane_pose, which pair pictures."""

    slop: float = number("s", low=0.0, high=1.0, doc="farthest apart in time that colour and depth may be", absent=0.04)


@dataclass(frozen=True)
class PlaceConfig:
    """Of the node camera_place."""

    mode: str = choice(AUTO, STORED, LIVE, doc="where the camera's place comes from", absent=AUTO)
    detector: str = text(doc="name of the detector node", absent="apriltag_ros_continuous_node")


@dataclass(frozen=True)
class WindowConfig:
    """Of the node stereo_view."""

    output: str = text(doc="the display's output; empty: the Rift, without one a window", absent="", empty=True)


@dataclass(frozen=True)
class WebConfig:
    """Of the node stereo_web: where the page is."""

    host: str = text(doc="address to serve on")
    port: int = integer(low=0, high=65535, doc="port; 0: any free one")
    page: str = path(doc="file of the page")
    certificate: str = path(doc="file of a certificate (PEM), for https")
    key: str = path(doc="file of the certificate's key (PEM)")

    def faults(self) -> list[str]:
        """Returns what no single field can check."""
        if bool(self.certificate) != bool(self.key):
            return ["certificate and key belong together, but only one of them is given."]
        return []

"""Private parameters of the node ros2_bridge."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, flag, integer, names, number, path

LOCALHOST, SUBNET = "localhost", "subnet"


@dataclass(frozen=True)
class Ros2BridgeConfig:
    """Of the node itself."""

    arms: tuple[str, ...] = names(doc="namespaces of several arms, such as [left, right]", absent=())
    discovery: str = choice(
        LOCALHOST, SUBNET, doc="where other nodes of ROS 2 may be: on this machine, or in its network", absent=LOCALHOST
    )
    network_motion: bool = flag(
        doc="with discovery subnet: whether ROS 2 may move the arm, which then every machine in the network may",
        absent=False,
    )
    camera_rate: float = number("Hz", low=0.1, high=60.0, doc="most compressed images a second", absent=10.0)
    jpeg_quality: int = integer("%", low=10, high=100, doc="quality of the compressed images", absent=80)
    python: str = path(doc="Python with ROS 2; empty: that of make ros2", absent="")

    @property
    def moves(self) -> bool:
        """Whether ROS 2 may move the arm."""
        return self.discovery == LOCALHOST or self.network_motion

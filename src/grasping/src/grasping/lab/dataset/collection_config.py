"""Private parameters of the node grasp_collection beside its sections."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import flag, number, path, text


@dataclass(frozen=True)
class CollectionConfig:
    """Of the node grasp_collection."""

    folder: str = path(doc="folder of the episodes; empty: leap_rig/grasps in ROS's home, ~/.ros")
    object: str = text(doc="what is grasped; may be set anew while the node runs")
    operator: str = text(doc="who teleoperates")
    tf_wait: float = number("s", above=0.0, high=5.0, doc="how long the places at an image's time are waited for")
    from_bag: bool = flag(doc="start the recording that collection_bag is about to play")

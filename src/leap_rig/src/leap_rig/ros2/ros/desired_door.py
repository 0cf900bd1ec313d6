"""Desired tool frames from ROS 2 into ROS 1's tf, where the controller judges them like those of any node."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable

from tf2_msgs.msg import TFMessage

from common import clock
from common.ros.publishing import DirectPublisher
from common.ros.raw_tf import RawTfMessage, RawTransform
from kuka_control.model.desired_frame import FrameSources
from kuka_control.ros.desired_tool import STATIC

BILLION = 10**9


class DesiredDoor:
    """Publishes the transforms of the frames `names` that come, and no others, under this node's name; so that this one
    says it where two nodes of ROS 2 publish the same frame. `refuse` takes a sentence about what is not published."""

    def __init__(self, names: Iterable[str], refuse: Callable[[str], None]) -> None:
        self._names, self._refuse = set(names), refuse
        self._sources = FrameSources()
        self._publisher = DirectPublisher("/tf", TFMessage, queue_size=100)
        self.taken = 0

    def take(self, node: str, data: bytes) -> None:
        """Takes a tf message of a node in ROS 2."""
        found = [transform.message for transform in self._wanted(node, data) if self._is_taken(node, transform)]
        if found:
            self.taken += len(found)
            self._publisher.publish(TFMessage(found))

    def take_static(self, node: str, data: bytes) -> None:
        """Refuses what is published on /tf_static, as the controller does."""
        if self._wanted(node, data):
            self._refuse(f"{STATIC} It came from {node} in ROS 2.")

    def _wanted(self, node: str, data: bytes) -> list[RawTransform]:
        try:
            transforms = list(RawTfMessage().deserialize(data).raw_transforms())
        except (struct.error, UnicodeDecodeError) as error:
            self._refuse(f"A message of {node} in ROS 2 on /tf is damaged and left out: {error}.")
            return []
        return [transform for transform in transforms if transform.child in self._names]

    def _is_taken(self, node: str, transform: RawTransform) -> bool:
        child, now = transform.child, clock.monotonic()
        alone = self._sources.heard(child, transform.parent, node, now)
        if not alone:
            self._refuse(f"The desired tool frame is refused: in ROS 2, {self._sources.conflict(child, now)}.")
        elif transform.stamp[1] >= BILLION:
            self._refuse(f"The desired tool frame is refused: its stamp has {transform.stamp[1]} nanoseconds.")
            return False
        return alone

"""The measured tool from the controller's tf frame of the flange."""

from __future__ import annotations

import struct

import numpy as np
import rospy

from common import clock
from common.frames import BASE, FLANGE_MEASURED, ONE_ARM, ArmFrames
from common.ros.conversions import pose_from_transform
from common.ros.raw_tf import RawTfMessage, data_of, publisher_of
from leap_kuka.numbers import MEASURED_AGE_S
from rig_msgs.msg import KukaStatus


class MeasuredTool:
    """Keeps the newest message with the flange; it is read only when it is asked for, since many others come on /tf.
    Only the controller's counts, the node that publishes kuka/status. `of`: its namespace with a slash, if it is not
    this node's own."""

    def __init__(self, T_flange_tool: np.ndarray, frames: ArmFrames = ONE_ARM, of: str = "") -> None:
        self._T_flange_tool = T_flange_tool
        self._base = frames(BASE)
        self._flange = frames(FLANGE_MEASURED)
        self._looked_for = self._flange.encode()
        self._controller = ""
        self._newest: dict[str, tuple[bytes, float, rospy.Time]] = {}  # by publisher
        rospy.Subscriber(f"{of}kuka/status", KukaStatus, self._on_status, queue_size=1, tcp_nodelay=True)
        rospy.Subscriber("/tf", rospy.AnyMsg, self._on_tf, queue_size=100, tcp_nodelay=True)

    def __call__(self) -> np.ndarray:
        """Returns T_base_tool, shape (4, 4) [m]; raises ValueError if it is unknown, old or not a pose."""
        data, at, received = self._newest.get(self._controller, (b"", 0.0, rospy.Time()))
        if not data:
            raise ValueError(f"the controller of the arm publishes no {self._flange}")
        if clock.monotonic() - at > MEASURED_AGE_S:
            raise ValueError(f"the newest {self._flange} is {clock.monotonic() - at:.1f} s old")
        try:
            transforms = list(RawTfMessage().deserialize(data).raw_transforms())
        except (struct.error, UnicodeDecodeError) as error:
            raise ValueError(f"the message on /tf is damaged: {error}") from None
        flange = next((t for t in reversed(transforms) if t.child == self._flange), None)
        if flange is None or flange.parent != self._base:
            raise ValueError(f"{self._flange} is not in {self._base}")
        age = received.to_sec() - flange.time
        if abs(age) > MEASURED_AGE_S:
            raise ValueError(f"the stamp of {self._flange} is {age:.1f} s old")
        return pose_from_transform(flange.message.transform) @ self._T_flange_tool

    def _on_status(self, status: KukaStatus) -> None:
        self._controller = publisher_of(status)

    def _on_tf(self, message: rospy.AnyMsg) -> None:
        data = data_of(message)
        if self._looked_for in data:
            self._newest[publisher_of(message)] = data, clock.monotonic(), rospy.Time.now()

"""The measured tool from the controller's tf frame of the flange."""

from __future__ import annotations

import time

import genpy
import numpy as np
import rospy
from tf2_msgs.msg import TFMessage

from common.frames import BASE, FLANGE_MEASURED
from common.ros.conversions import pose_from_transform

FRESH_S = 0.5  # an older measurement, or one with a stamp that is farther off, does not count
NAME = FLANGE_MEASURED.encode()


class MeasuredTool:
    """Keeps the newest message with the flange; it is read only when it is asked for, since many others come on /tf."""

    def __init__(self, T_flange_tool: np.ndarray) -> None:
        self._T_flange_tool = T_flange_tool
        self._newest = b"", 0.0, rospy.Time()
        rospy.Subscriber("/tf", rospy.AnyMsg, self._on_tf, queue_size=100, tcp_nodelay=True)

    def __call__(self) -> np.ndarray:
        """Returns T_base_tool, shape (4, 4) [m]; raises ValueError if it is unknown, old or not a pose."""
        data, at, received = self._newest
        if not data:
            raise ValueError(f"nobody publishes {FLANGE_MEASURED}")
        if time.monotonic() - at > FRESH_S:
            raise ValueError(f"the newest {FLANGE_MEASURED} is {time.monotonic() - at:.1f} s old")
        try:
            transforms = TFMessage().deserialize(data).transforms
        except genpy.DeserializationError as error:
            raise ValueError(f"the message on /tf is damaged: {error}") from None
        flange = next((t for t in reversed(transforms) if t.child_frame_id.lstrip("/") == FLANGE_MEASURED), None)
        if flange is None or flange.header.frame_id.lstrip("/") != BASE:
            raise ValueError(f"{FLANGE_MEASURED} is not in {BASE}")
        age = (received - flange.header.stamp).to_sec()
        if abs(age) > FRESH_S:
            raise ValueError(f"the stamp of {FLANGE_MEASURED} is {age:.1f} s old")
        return pose_from_transform(flange.transform) @ self._T_flange_tool

    def _on_tf(self, message: rospy.AnyMsg) -> None:
        if NAME in message._buff:
            self._newest = message._buff, time.monotonic(), rospy.Time.now()

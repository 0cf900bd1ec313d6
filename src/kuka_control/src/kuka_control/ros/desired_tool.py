"""The only input of a controller: the tf transform to the desired tool frame, from any node, through any chain."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import rospy
import tf2_ros

from common.frames import BASE, TOOL_DESIRED
from common.ros.conversions import pose_from_transform
from kuka_control.model.desired_frame import Conflict, DesiredFrame, FrameSources

REMIND_S = 5.0


class DesiredTool(tf2_ros.TransformListener):
    """Listens to tf and wakes the control loop when something came.

    A frame that two nodes publish jumps between what both say, so it is left out; if the desired tool frame stands in
    it, that one counts as refused.

    Attributes:
        stamp: that of the newest desired tool frame, as it came; None before the first.
    """

    def __init__(self) -> None:
        self._arrived = threading.Event()
        self._newest: DesiredFrame | None = None
        self._sources = FrameSources()
        self._conflict: Conflict | None = None
        self.stamp: rospy.Time | None = None
        super().__init__(tf2_ros.Buffer(debug=False), tcp_nodelay=True)

    def callback(self, data) -> None:
        """Receives tf messages; drops transforms that are not finite."""
        self._leave_out_conflicts(data)
        good = [t for t in data.transforms if _finite(t.transform)]
        if len(good) < len(data.transforms):
            bad = next(t for t in data.transforms if not _finite(t.transform))
            rospy.logwarn_throttle(
                REMIND_S, f"The transform {bad.header.frame_id} -> {bad.child_frame_id} is refused: it is not finite."
            )
            data.transforms = good
        super().callback(data)
        self._arrived.set()

    def wait(self, deadline: float) -> DesiredFrame | None:
        """Returns the newest desired tool frame as soon as a new one is there, or at the monotonic `deadline` [s]."""
        while not self._look() and time.monotonic() < deadline:
            self._arrived.wait(max(deadline - time.monotonic(), 0.0))
            self._arrived.clear()
        return self._newest

    def _leave_out_conflicts(self, data) -> None:
        node, now = data._connection_header["callerid"], time.monotonic()
        data.transforms = [
            t
            for t in data.transforms
            if self._sources.heard(_name(t.child_frame_id), _name(t.header.frame_id), node, now)
        ]

    def _look(self) -> bool:
        """Looks the frame up; returns whether it is new."""
        conflict = self._sources.conflict(TOOL_DESIRED, time.monotonic())
        if conflict is not None:
            if conflict is self._conflict:
                return False
            self._conflict, self.stamp = conflict, rospy.Time.now()
            self._newest = DesiredFrame(
                np.eye(4), self.stamp.to_sec(), f"The desired tool frame is refused: {conflict}."
            )
            return True
        try:
            message = self.buffer.lookup_transform(BASE, TOOL_DESIRED, rospy.Time(0))
            if message.header.stamp == self.stamp:
                return False
            self.stamp = message.header.stamp
            self._newest = DesiredFrame(pose_from_transform(message.transform), self.stamp.to_sec())
        except tf2_ros.TransformException:
            return False
        except ValueError as error:
            rospy.logwarn_throttle(REMIND_S, f"The desired tool frame is refused: {error}.")
            return False
        return True


def _name(frame: str) -> str:
    """Returns the tf2 name of a frame, without the leading slash of old nodes."""
    return frame.lstrip("/")


def _finite(transform) -> bool:
    t, q = transform.translation, transform.rotation
    return all(map(math.isfinite, (t.x, t.y, t.z, q.x, q.y, q.z, q.w)))

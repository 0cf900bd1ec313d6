"""The camera pose at the stamp of an image, from tf."""

from __future__ import annotations

import numpy as np
import rospy
import tf2_ros

from common.frames import BASE
from common.ros.conversions import pose_from_transform

PATIENCE_S = 0.1
"""The camera pose at an image's stamp may arrive this much later than the image."""


class CameraPoseLookup:
    """Looks camera poses up in tf; a missing or stale pose comes with the reason."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    def in_base(self, frame: str, stamp: rospy.Time) -> tuple[np.ndarray | None, str]:
        """Returns T_base_camera, shape (4, 4) [m], at a moment, or None and why, a clause."""
        try:
            return self._look_up(BASE, frame, stamp), ""
        except tf2_ros.ExtrapolationException:
            return None, f"the camera pose is stale: tf has no {frame} in {BASE} at the image's stamp"
        except tf2_ros.TransformException:
            return None, f"the camera pose is unknown: tf does not connect {frame} and {BASE}; calibrate the camera"
        except ValueError as error:
            return None, f"the camera pose in tf is invalid: {error}"

    def fixed(self, parent: str, child: str) -> np.ndarray | None:
        """Returns the pose of a frame in another one to which it is fixed, shape (4, 4) [m]; None if tf has it not."""
        try:
            return pose_from_transform(self._buffer.lookup_transform(parent, child, rospy.Time(0)).transform)
        except (tf2_ros.TransformException, ValueError):
            return None

    def _look_up(self, parent: str, child: str, stamp: rospy.Time) -> np.ndarray:
        try:
            found = self._buffer.lookup_transform(parent, child, stamp)
        except tf2_ros.ExtrapolationException:
            found = self._buffer.lookup_transform(parent, child, stamp, rospy.Duration(PATIENCE_S))
        return pose_from_transform(found.transform)

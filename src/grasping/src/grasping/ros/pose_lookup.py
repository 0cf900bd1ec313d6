"""Poses in the base frame that tf knows, or why they cannot be used."""

from __future__ import annotations

import numpy as np
import rospy
import tf2_ros
import yaml

from common.frames import BASE, FLANGE_MEASURED, GRASP_VIEW
from common.plausible import check_near
from common.ros.conversions import pose_from_transform


class PoseLookup:
    """Looks poses up in tf."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    def in_base(self, frame: str, stamp: rospy.Time) -> tuple[np.ndarray | None, str]:
        """Returns T_base_camera, shape (4, 4) [m], at a moment, or None and why it is missing or stale, a clause."""
        patience_s = 0.1  # the camera pose at an image's stamp may arrive this much later than the image
        try:
            try:
                return self.at(frame, stamp), ""
            except tf2_ros.ExtrapolationException:
                return self.at(frame, stamp, patience_s), ""
        except tf2_ros.ExtrapolationException:
            return None, f"the camera pose is stale: tf has no {frame} in {BASE} at the image's stamp"
        except tf2_ros.TransformException:
            return None, f"the camera pose is unknown: {self._unknown(frame)}"
        except ValueError as error:
            return None, f"the camera pose in tf is invalid: {error}"

    def _unknown(self, frame: str) -> str:
        """Returns why tf does not know a frame in the base, a clause; ggcnn itself publishes one below the camera's."""
        tree = yaml.safe_load(self._buffer.all_frames_as_yaml()) or {}
        if frame in tree or frame in {entry["parent"] for child, entry in tree.items() if child != GRASP_VIEW}:
            return f"tf does not connect {frame} and {BASE}; calibrate the camera"
        return f"tf has no frame {frame!r}, which the image names; start what publishes it, such as the camera's driver"

    def fixed(self, parent: str, child: str) -> np.ndarray | None:
        """Returns the pose of a frame in another one to which it is fixed, shape (4, 4) [m]; None if tf has it not."""
        try:
            return pose_from_transform(self._buffer.lookup_transform(parent, child, rospy.Time(0)).transform)
        except (tf2_ros.TransformException, ValueError):
            return None

    def at(self, frame: str, stamp: rospy.Time, wait: float = 0.0) -> np.ndarray:
        """Returns T_base_frame, shape (4, 4) [m], at a moment; waits for it, `wait` [s] at most. Raises
        tf2_ros.TransformException if tf does not know it, ValueError if it is not a pose in metres.
        """
        found = self._buffer.lookup_transform(BASE, frame, stamp, rospy.Duration(wait))
        return check_near(pose_from_transform(found.transform))

    def flange(self, max_age: float) -> np.ndarray:
        """Returns the newest measured T_base_flange, as `newest` does."""
        return self.newest(FLANGE_MEASURED, max_age)

    def newest(self, frame: str, max_age: float) -> np.ndarray:
        """Returns the newest T_base_frame, shape (4, 4) [m]. Raises tf2_ros.TransformException if tf does not know it,
        ValueError if older than `max_age` [s] or not a pose.
        """
        found = self._buffer.lookup_transform(BASE, frame, rospy.Time(0))
        if abs((rospy.Time.now() - found.header.stamp).to_sec()) > max_age:
            raise ValueError(f"the pose of {frame} is older than {max_age:g} s")
        return check_near(pose_from_transform(found.transform))

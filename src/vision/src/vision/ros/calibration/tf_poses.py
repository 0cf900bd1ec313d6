"""Looks up the poses that determine the camera pose in tf, and reports which one is missing or stale."""

from __future__ import annotations

import numpy as np
import rospy
import tf2_ros

from common.errors import DeviceError
from common.frames import BASE, CAMERA_LINK, FLANGE_MEASURED
from common.poses import inverse
from common.ros.conversions import pose_from_transform, stamped_transform

STATIC_WAIT_S = 10.0


class TfPoses:
    """Looks up poses in tf."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    def flange(self, stamp: rospy.Time, timeout: float) -> np.ndarray:
        """Returns T_base_flange, shape (4, 4) [m], at a time; waits up to `timeout` [s] for it.

        Raises:
            DeviceError: the arm's controller did not publish the flange for this time.
        """
        return self._lookup(BASE, FLANGE_MEASURED, stamp, timeout, "is the arm's controller running?")

    def camera_link(self, T_base_optical: np.ndarray, optical: str, stamp: rospy.Time):
        """Returns the tf message of camera_link in the base, from the pose of the optical frame, shape (4, 4) [m].

        Raises:
            DeviceError: the camera's driver does not publish its frames.
        """
        hint = "is the camera's driver running?"
        T_link_optical = self._lookup(CAMERA_LINK, optical, rospy.Time(0), STATIC_WAIT_S, hint)
        return stamped_transform(T_base_optical @ inverse(T_link_optical), BASE, CAMERA_LINK, stamp)

    def _lookup(self, parent: str, child: str, stamp: rospy.Time, timeout: float, hint: str) -> np.ndarray:
        try:
            found = self._buffer.lookup_transform(parent, child, stamp, rospy.Duration(timeout))
            return pose_from_transform(found.transform)
        except (tf2_ros.LookupException, tf2_ros.ConnectivityException):
            raise DeviceError(f"tf has no path from {parent} to {child}: {hint}") from None
        except tf2_ros.ExtrapolationException:
            raise DeviceError(f"The frame {child} is stale at the time of the image: {hint}") from None
        except ValueError as error:
            raise DeviceError(f"tf has an invalid {child}: {error}") from None

"""The frames that the place of the camera is made of, from tf; what is stale or missing is refused with a sentence."""

from __future__ import annotations

import numpy as np
import rospy
import tf2_ros

from common.errors import DeviceError
from common.frames import BASE, CAMERA_LINK, FLANGE_MEASURED
from common.poses import inverse
from common.ros.conversions import pose_from_transform, stamped_transform

STATIC_WAIT_S = 10.0


class Frames:
    """Looks frames up."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    def flange(self, stamp: rospy.Time, timeout: float) -> np.ndarray:
        """Returns T_base_flange, shape (4, 4) [m], at a moment; waits up to `timeout` [s] for it.

        Raises:
            DeviceError: the arm's controller does not say where the flange was then.
        """
        return self._at(BASE, FLANGE_MEASURED, stamp, timeout, "is the arm's controller running?")

    def link_from_optical(self, optical: str) -> np.ndarray:
        """Returns the pose of the optical frame in camera_link, shape (4, 4) [m].

        Raises:
            DeviceError: the camera's driver does not say.
        """
        return self._at(CAMERA_LINK, optical, rospy.Time(0), STATIC_WAIT_S, "is the camera's driver running?")

    def camera_link(self, T_base_optical: np.ndarray, optical: str, stamp: rospy.Time):
        """Returns the tf message of camera_link in the base.

        Raises:
            DeviceError: as `link_from_optical`.
        """
        T = T_base_optical @ inverse(self.link_from_optical(optical))
        return stamped_transform(T, BASE, CAMERA_LINK, stamp)

    def _at(self, parent: str, child: str, stamp: rospy.Time, timeout: float, hint: str) -> np.ndarray:
        try:
            found = self._buffer.lookup_transform(parent, child, stamp, rospy.Duration(timeout))
            return pose_from_transform(found.transform)
        except (tf2_ros.LookupException, tf2_ros.ConnectivityException):
            raise DeviceError(f"tf has no way from {parent} to {child}; {hint}") from None
        except tf2_ros.ExtrapolationException:
            raise DeviceError(f"tf does not know {child} at the moment of the picture: it is stale; {hint}") from None
        except ValueError as error:
            raise DeviceError(f"tf has a wrong {child}: {error}") from None

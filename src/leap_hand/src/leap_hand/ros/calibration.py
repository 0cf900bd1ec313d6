"""Has the robot hand calibrate itself before it is commanded."""

from __future__ import annotations

import time

import rospy
from std_srvs.srv import Empty

from common.errors import DeviceError
from common.ros.service_calls import call

SERVICES = ("reflex_takktile/calibrate_fingers", "reflex_takktile/calibrate_tactile")
ANSWER_TIMEOUT_S = 10.0
SETTLING_S = 2.0
"""Both services answer at once and the fingers move for up to two seconds; a command would fight the calibration."""


def calibrate(timeout: float) -> None:
    """Calls both calibrations and waits until they have ended.

    Args:
        timeout: how long to wait for the services to appear [s].

    Raises:
        DeviceError: a service is not there, refuses, or does not answer.
        rospy.ROSInterruptException: ROS shut down.
    """
    for name in SERVICES:
        rospy.loginfo("Waiting for the service %s.", name)
        try:
            rospy.wait_for_service(name, timeout)
        except rospy.ROSInterruptException:
            raise
        except rospy.ROSException:
            raise DeviceError(
                f"The service {name} is not there after {timeout:g} s: is the driver of the ReFlex hand running?"
            ) from None
    for name in SERVICES:
        call(name, Empty, timeout=ANSWER_TIMEOUT_S)
    rospy.loginfo("The hand calibrates; commands follow in %g s.", SETTLING_S)
    end = time.monotonic() + SETTLING_S
    while time.monotonic() < end:
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shut down during the calibration")
        time.sleep(0.05)

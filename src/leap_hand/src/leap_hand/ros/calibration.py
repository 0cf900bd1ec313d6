"""Has the robot hand calibrate itself before it is commanded."""

from __future__ import annotations

import threading
import time

import rospy
from std_srvs.srv import Empty

from common.errors import DeviceError

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
        _call(name)
    rospy.loginfo("The hand calibrates; commands follow in %g s.", SETTLING_S)
    end = time.monotonic() + SETTLING_S
    while time.monotonic() < end:
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shut down during the calibration")
        time.sleep(0.05)


def _call(name: str) -> None:
    """Calls a service; rospy's own calls know no time-out, so a thread makes it."""
    faults: list[str] = []

    def call() -> None:
        try:
            rospy.ServiceProxy(name, Empty)()
        except rospy.ServiceException as error:
            faults.append(str(error))

    caller = threading.Thread(target=call, name=name, daemon=True)
    caller.start()
    caller.join(ANSWER_TIMEOUT_S)
    if caller.is_alive():
        raise DeviceError(f"The service {name} did not answer within {ANSWER_TIMEOUT_S:g} s.")
    if faults:
        raise DeviceError(f"The service {name} failed: {faults[0]}.")

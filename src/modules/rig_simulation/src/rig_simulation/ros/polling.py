"""Polls the control port of a simulated device: at a rate while it answers, patiently while it does not."""

from __future__ import annotations

import time
from collections.abc import Callable

import rospy

from common.errors import DeviceError

RETRY_PERIOD_S = 0.5
REMIND_S = 10.0
START_S = 5.0
"""So long a device may take to start, or to start again: for so long nobody complains of its silence."""


def poll(publish: Callable[[], None], period: float) -> None:
    """Calls `publish`, which asks the device and publishes what it says, until ROS shuts down.

    Args:
        publish: raises DeviceError while the device does not answer.
        period: from call to call while it does [s].
    """
    due = answered = time.monotonic()
    while not rospy.is_shutdown():
        try:
            publish()
        except DeviceError as error:
            if time.monotonic() - answered > START_S:
                rospy.logwarn_throttle(REMIND_S, "%s", error)
            due = time.monotonic() + RETRY_PERIOD_S
        else:
            answered = time.monotonic()
            due = max(due + period, answered)
        time.sleep(max(0.0, due - time.monotonic()))

"""Warns of a simulated device that does not answer, but not while it may only be starting."""

from __future__ import annotations

import time

import rospy

START_S = 5.0
"""So long a device may take to start, or to start again."""
REMIND_S = 10.0


class Silence:
    """How long a device has not answered."""

    def __init__(self) -> None:
        self._since = time.monotonic()

    def is_over(self) -> None:
        """The device has answered."""
        self._since = time.monotonic()

    def goes_on(self, error: Exception) -> None:
        """The device has not answered; the log says so if that lasts."""
        if time.monotonic() - self._since > START_S:
            rospy.logwarn_throttle(REMIND_S, "%s", error)

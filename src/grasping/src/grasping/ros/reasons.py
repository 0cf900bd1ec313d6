"""Says in the log why there is no grasp, when that changes."""

from __future__ import annotations

import re

import rospy

NUMBERS = re.compile(r"-?\d+(\.\d+)?")


class ReasonLog:
    """Logs a reason when it becomes another one; numbers in it may change unsaid.

    Attributes:
        present: the newest reason, a clause; empty where there is none.
    """

    def __init__(self) -> None:
        self.present = "no depth image has been looked at"
        self._kind = self.present

    def tell(self, reason: str) -> None:
        """Takes the newest reason in."""
        self.present = reason
        kind = NUMBERS.sub("#", reason)
        if kind == self._kind:
            return
        self._kind = kind
        if reason:
            rospy.logwarn("No grasp, or none that is known to be reachable: %s.", reason)
        else:
            rospy.loginfo("There are grasps, and the best is reachable.")

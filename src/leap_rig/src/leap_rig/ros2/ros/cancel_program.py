"""Cancels kuka/move for a bridge that ended while a client in ROS 2 moved the arm."""

from __future__ import annotations

import sys

import rospy
from actionlib_msgs.msg import GoalID

from common import clock
from common.ros.node import join, run_program


def main() -> None:
    """Cancels the motions of the actions that the arguments name."""
    run_program("ros2_bridge", lambda: _cancel(sys.argv[1:]), "Interrupted.")


def _cancel(actions: list[str]) -> None:
    longest_s, sent_s = 5.0, 0.5
    join("ros2_bridge_cancels", anonymous=True)
    publishers = [rospy.Publisher(f"{action}/cancel", GoalID, queue_size=1, latch=True) for action in actions]
    for publisher in publishers:
        publisher.publish(GoalID())  # of all goals
    deadline = clock.monotonic() + longest_s
    while not all(p.get_num_connections() for p in publishers) and clock.monotonic() < deadline:
        clock.sleep(0.05)
    clock.sleep(sent_s)
    print("ros2_bridge has ended while a client in ROS 2 moved the arm, so the motion is cancelled.")

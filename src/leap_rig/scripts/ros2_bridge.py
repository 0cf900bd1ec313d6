#!/usr/bin/env python3
"""Node that is the door to ROS 2."""

from common.ros.node import run
from leap_rig.ros2.ros.bridge_node import main

run("ros2_bridge", main)

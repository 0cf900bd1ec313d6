#!/usr/bin/env python3
"""Node that is leap_driver, leap_kuka_node and leap_hand_node in one process."""

from leap_rig.ros.leap_teleop import main

main()

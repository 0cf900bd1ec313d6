#!/usr/bin/env python3
"""The control panel of the arm and the gripper."""

from kuka_control.ros.panel_link import main

main()

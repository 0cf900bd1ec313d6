#!/usr/bin/env python3
"""Program that lets LeRobot's programs see the rig, and move it."""

from leap_rig.lerobot.ros.server_program import main

main()

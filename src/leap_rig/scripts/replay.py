#!/usr/bin/env python3
"""Program that plays a recording: in RViz, as a tracker, or on the robot."""

from leap_rig.recording.ros.replay_program import main

main()

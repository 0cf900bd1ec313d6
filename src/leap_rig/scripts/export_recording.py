#!/usr/bin/env python3
"""Program that exports a recording to MCAP or to a LeRobot dataset."""

from leap_rig.recording.ros.export_program import main

main()

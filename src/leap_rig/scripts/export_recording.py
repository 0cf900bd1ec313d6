#!/usr/bin/env python3
"""Program that exports a recording to MCAP, CSV files or a LeRobot dataset."""

from leap_rig.recording.ros.export_program import main

main()

#!/usr/bin/env python3
"""Program that records a run of the rig."""

from leap_rig.recording.ros.record_program import main

main()

#!/usr/bin/env python3
"""Program that records episodes of a task."""

from leap_rig.recording.ros.episodes_program import main

main()

#!/usr/bin/env python3
"""Finds the camera pose: the arm shows the marker board to the camera from many sides. See --help."""

from vision.ros.calibration.calibrate_program import main

main()

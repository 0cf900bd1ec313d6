#!/usr/bin/env python3
"""Finds where the camera stands: the arm shows the marker board to it from many sides. See --help."""

from vision.ros.calibration.calibrate_program import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Measures the accuracy of calibrations on simulated images, with wrong lenses and an inexact arm; see --help."""

import sys

from vision.ros.calibration.evaluate_program import main

sys.exit(main())

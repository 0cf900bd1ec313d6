#!/usr/bin/env python3
"""Measures the gain of the photometric refinement for the calibration; see --help."""

import sys

from vision.ros.calibration.evaluate_program import main

sys.exit(main())

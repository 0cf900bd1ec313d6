#!/usr/bin/env python3
"""Finds where the second of two arms stands, from the calibrations of one camera to both; see --help."""

import sys

from vision.ros.calibration.register_arms_program import main

sys.exit(main())

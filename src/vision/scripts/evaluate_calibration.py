#!/usr/bin/env python3
"""What the photometric refinement gains for the camera's calibration; see --help."""

import sys

from vision.ros.calibration.evaluate_program import main

sys.exit(main())

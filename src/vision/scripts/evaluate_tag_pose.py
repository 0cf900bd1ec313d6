#!/usr/bin/env python3
"""Compares the poses of the marker board by colour, depth and both with the truth. See --help."""

import sys

from vision.ros.marker_board.evaluate_program import main

sys.exit(main())

#!/usr/bin/env python3
"""Compares the poses of the marker board by colour, depth and both with the truth. See --help."""

import sys

from common.ros.node import need_home

need_home("evaluate_tag_pose")

from vision.ros.marker_board.evaluate_program import main  # noqa: E402

sys.exit(main())

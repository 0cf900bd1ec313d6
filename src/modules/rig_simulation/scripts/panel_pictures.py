#!/usr/bin/env python3
"""Renders images of the marker board with their true poses; needs no ROS master. See --help."""

import sys

from rig_simulation.devices.camera.board_images import main

sys.exit(main())

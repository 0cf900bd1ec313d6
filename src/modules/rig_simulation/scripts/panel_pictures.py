#!/usr/bin/env python3
"""Takes pictures of the marker panel with the truth beside them; needs no ROS master. See --help."""

import sys

from rig_simulation.devices.camera.board_images import main

sys.exit(main())

#!/usr/bin/env python3
"""Shows the simulated world in MuJoCo's window; needs no ROS master. See --help."""

import sys

from rig_simulation.recording.viewer import main

sys.exit(main())

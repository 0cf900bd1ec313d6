#!/usr/bin/env python3
"""Films the simulated world without a screen; needs no ROS master. See --help."""

import os
import sys

os.environ.setdefault("MUJOCO_GL", "egl")  # MuJoCo reads it when it is imported

from rig_simulation.recording.record import main

sys.exit(main())

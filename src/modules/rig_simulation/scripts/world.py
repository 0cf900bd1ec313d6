#!/usr/bin/env python3
"""The simulated arm and hand in one world with a table and objects; needs no ROS master. See --help."""

import sys

from rig_simulation.world.program import main

sys.exit(main())

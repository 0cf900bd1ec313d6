#!/usr/bin/env python3
"""Simulated service of the Leap Motion controller; needs no ROS master. See --help."""

import sys

from rig_simulation.devices.leap.program import main

sys.exit(main())

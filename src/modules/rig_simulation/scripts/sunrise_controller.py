#!/usr/bin/env python3
"""Simulated KUKA Sunrise controller; needs no ROS master. See --help."""

import sys

from rig_simulation.devices.sunrise.program import main

sys.exit(main())

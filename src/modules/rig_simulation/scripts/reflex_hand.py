#!/usr/bin/env python3
"""Simulated ReFlex TakkTile hand on its UDP wire; needs no ROS master."""

import sys

from rig_simulation.devices.reflex.program import main

if __name__ == "__main__":
    sys.exit(main())

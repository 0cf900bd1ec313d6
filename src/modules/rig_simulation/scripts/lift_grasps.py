#!/usr/bin/env python3
"""Tries grasps with the rig's hand."""

import sys

from rig_simulation.world.lifting import main

if __name__ == "__main__":
    sys.exit(main())

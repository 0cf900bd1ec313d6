#!/usr/bin/env python3
"""Measures where a tracker stands on the desk, and stores that under a name; see --help."""

import sys

from leap_motion.ros.register_program import main

if __name__ == "__main__":
    sys.exit(main())

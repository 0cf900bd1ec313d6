#!/usr/bin/env python3
"""A webcam as a Leap service."""

import sys

from common.screen import no_window
from leap_motion.webcam.webcam_program import main

if __name__ == "__main__":
    sys.exit(main(no_window=no_window))

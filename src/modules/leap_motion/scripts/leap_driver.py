#!/usr/bin/env python3
"""Driver node of the Leap Motion controller."""

from leap_motion.ros.driver import main

if __name__ == "__main__":
    main()

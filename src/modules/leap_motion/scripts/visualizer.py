#!/usr/bin/env python3
"""Shows the tracker's hands in RViz: joints, bones, and confidence as colour."""

from leap_motion.ros.visualizer import main

if __name__ == "__main__":
    main()

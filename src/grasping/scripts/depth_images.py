#!/usr/bin/env python3
"""Takes depth images out of a bag or from a running camera."""

from grasping.lab.ros.depth_images import main

if __name__ == "__main__":
    main()

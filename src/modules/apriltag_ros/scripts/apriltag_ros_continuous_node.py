#!/usr/bin/env python3
"""Detector node of AprilTags in the images of a camera."""

from apriltag_ros.ros.continuous_node import main

if __name__ == "__main__":
    main()

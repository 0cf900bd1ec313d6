#!/usr/bin/env python3
"""Service node that detects AprilTags in an image in a file."""

from apriltag_ros.ros.single_image_server import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Publishes the camera pose, from the stored calibration or live."""

from vision.ros.calibration.camera_pose_node import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Publishes where the camera stands, from the stored calibration or live."""

from vision.ros.camera_place import main

if __name__ == "__main__":
    main()

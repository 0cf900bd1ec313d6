#!/usr/bin/env python3
"""Publishes the camera pose, from the stored calibration or live."""

from common.ros.node import run
from vision.ros.calibration.camera_pose_node import main

run("camera_place", main)

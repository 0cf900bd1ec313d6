#!/usr/bin/env python3
"""Detector node of AprilTags in the images of a camera."""

from apriltag_ros.ros.continuous_node import main
from common.ros.node import run

run("apriltag_ros_continuous_node", main)

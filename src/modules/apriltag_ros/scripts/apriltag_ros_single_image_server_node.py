#!/usr/bin/env python3
"""Service node that detects AprilTags in an image in a file."""

from apriltag_ros.ros.single_image_server import main
from common.ros.node import run

run("apriltag_ros_single_image_server", main)

#!/usr/bin/env python3
"""Node that publishes the frames of the RGB-D camera."""

from common.ros.node import run
from vision.ros.camera.frames_node import main

run("camera_frames", main)

#!/usr/bin/env python3
"""Node that says when the camera froze or vanished."""

from common.ros.node import run
from vision.ros.camera.watchdog_node import main

run("camera_watchdog", main)

#!/usr/bin/env python3
"""Node that reports a frozen or vanished camera."""

from common.ros.node import run
from vision.ros.camera.watchdog_node import main

run("camera_watchdog", main)

#!/usr/bin/env python3
"""Node that publishes where the camera of the simulated world truly is."""

from common.ros.node import run
from rig_simulation.ros.monitors import camera_truth

run("camera_truth", camera_truth)

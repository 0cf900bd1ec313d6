#!/usr/bin/env python3
"""Node of the simulated RGB-D camera."""

from common.ros.node import run
from rig_simulation.ros.camera import main

run("camera", main)

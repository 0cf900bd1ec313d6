#!/usr/bin/env python3
"""Node that shows on topics what the simulated arm really does, and holds the key "run" as a service."""

from common.ros.node import run
from rig_simulation.ros.monitor import main

run("rig_monitor", main)

#!/usr/bin/env python3
"""Node that shows on topics what the simulated arm really does, and holds the key "run" as a service."""

from common.ros.node import run
from rig_simulation.ros.monitors import arm_monitor

run("rig_monitor", arm_monitor)

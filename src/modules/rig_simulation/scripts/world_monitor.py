#!/usr/bin/env python3
"""Node that publishes the objects of the simulated world and offers resets."""

from common.ros.node import run
from rig_simulation.ros.monitors import world_monitor

run("world_monitor", world_monitor)

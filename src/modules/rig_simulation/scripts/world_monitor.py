#!/usr/bin/env python3
"""Node that publishes the objects of the simulated world and offers resets."""

from common.ros.node import run
from rig_simulation.ros.world_monitor import NAME, main

run(NAME, main)

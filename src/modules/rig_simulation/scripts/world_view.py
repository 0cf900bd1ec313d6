#!/usr/bin/env python3
"""Node that shows table, objects and contact forces of the simulated world as markers."""

from common.ros.node import run
from rig_simulation.ros.world_view import NAME, main

run(NAME, main)

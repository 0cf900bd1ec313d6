#!/usr/bin/env python3
"""Node that shows what the simulated arm and world really do, and switches faults, resets and the key "run"."""

from common.ros.node import run
from rig_simulation.ros.monitors import simulation

run("simulation", simulation)

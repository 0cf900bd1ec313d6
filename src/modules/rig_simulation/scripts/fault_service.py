#!/usr/bin/env python3
"""Node that switches the faults of the simulated devices."""

from common.ros.node import run
from rig_simulation.ros.monitors import fault_service

run("simulation_faults", fault_service)

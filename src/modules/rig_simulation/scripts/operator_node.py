#!/usr/bin/env python3
"""Node that simulates the operator of the rig. (A script `operator.py` would hide Python's own module.)"""

from common.ros.node import run
from rig_simulation.ros.operator import NAME, main

run(NAME, main)

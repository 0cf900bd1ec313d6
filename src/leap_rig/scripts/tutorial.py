#!/usr/bin/env python3
"""Node that leads a visitor through the first minutes at the rig."""

from common.ros.node import run
from leap_rig.operator.ros.tutorial_node import main

run("tutorial", main)

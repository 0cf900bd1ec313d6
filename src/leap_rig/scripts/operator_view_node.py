#!/usr/bin/env python3
"""Shows the operator the state of the rig in RViz, the control panel and the headset's page."""

from common.ros.node import run
from leap_rig.operator.ros.view_node import main

run("operator_view", main)

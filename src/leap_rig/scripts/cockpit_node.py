#!/usr/bin/env python3
"""Serves the cockpit: a page that shows the whole rig and commands it."""

from common.ros.node import run
from leap_rig.cockpit.ros.cockpit_node import main

run("cockpit", main)

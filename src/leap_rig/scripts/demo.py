#!/usr/bin/env python3
"""Starts the whole rig, shows what it does, and reports."""

from leap_rig.ros.demo import main

main()

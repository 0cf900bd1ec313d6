#!/usr/bin/env python3
"""Shows the workspace, and says what is wrong with a bad one. See --help."""

from kuka_control.ros.plotter_program import main

main()

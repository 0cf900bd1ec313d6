#!/usr/bin/env python3
"""Moves the arm by the running controller: a name, joints, or a tool pose. See --help."""

from kuka_control.ros.move_program import main

main()

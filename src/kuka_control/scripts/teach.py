#!/usr/bin/env python3
"""Teaches the arm a motion by hand, and plays it back. See --help."""

from kuka_control.ros.teach_program import main

main()

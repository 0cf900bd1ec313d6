#!/usr/bin/env python3
"""Moves the arm to one joint configuration, after it has asked. See --help."""

from kuka_control.ros.simple_program import main

main()

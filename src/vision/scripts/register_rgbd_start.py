#!/usr/bin/env python3
"""Starts the nodelets that register depth to colour, or our own node."""

from vision.ros.register_choice import main

main()

#!/usr/bin/env python3
"""Starts the nodelets that register depth to colour, or our own node."""

from vision.ros.camera.register_node import start

start()

#!/usr/bin/env python3
"""Publishes depth in the colour camera's pixels and the coloured cloud."""

from vision.ros.camera.register_node import main

main()

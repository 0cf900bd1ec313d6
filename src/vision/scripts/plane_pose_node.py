#!/usr/bin/env python3
"""Publishes the marker panel's pose from colour and depth."""

from vision.ros.plane_pose import main

main()

#!/usr/bin/env python3
"""Publishes the marker board's pose from colour and depth."""

from common.ros.node import run
from vision.ros.marker_board.plane_pose_node import main

run("plane_pose", main)

#!/usr/bin/env python3
"""The headset view in a window."""

from common.ros.node import run
from vision.ros.stereo.view_node import main

run("stereo_view", main)

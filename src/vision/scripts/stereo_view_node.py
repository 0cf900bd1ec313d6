#!/usr/bin/env python3
"""The view for the headset in a window."""

from vision.ros.stereo.view_node import main

main()

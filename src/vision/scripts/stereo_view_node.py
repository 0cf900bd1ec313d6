#!/usr/bin/env python3
"""The headset view in a window."""

from vision.ros.stereo.view_node import main

main()

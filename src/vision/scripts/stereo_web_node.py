#!/usr/bin/env python3
"""The view for the headset as a web page."""

from vision.ros.stereo.web_node import main

main()

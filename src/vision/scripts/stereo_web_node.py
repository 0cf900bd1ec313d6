#!/usr/bin/env python3
"""The headset view as a web page."""

from vision.ros.stereo.web_node import main

main()

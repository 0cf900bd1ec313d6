#!/usr/bin/env python3
"""The headset view as a web page."""

from common.ros.node import run
from vision.ros.stereo.web_node import main

run("stereo_web", main)

#!/usr/bin/env python3
"""Node of the Xtion Pro Live."""

from common.ros.node import run
from vision.ros.camera.xtion_node import main

run("camera", main)

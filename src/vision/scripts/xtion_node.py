#!/usr/bin/env python3
"""Node of the XtionNode Pro Live."""

from common.ros.node import run
from vision.ros.camera.xtion_node import main

run("camera", main)

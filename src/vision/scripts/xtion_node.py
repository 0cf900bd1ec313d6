#!/usr/bin/env python3
"""Node of the Xtion Pro Live."""

from common.ros.node import run
from vision.ros.xtion import main

run("camera", main)

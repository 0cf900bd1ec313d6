#!/usr/bin/env python3
"""Node reflex_takktile_driver: drives the ReFlex TakkTile hand."""

from common.ros.node import run
from reflex.ros.driver import main

if __name__ == "__main__":
    run("reflex_takktile_driver", main)

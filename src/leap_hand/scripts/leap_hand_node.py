#!/usr/bin/env python3
"""Starts the node that turns the fingers over the Leap into commands of the ReFlex hand."""

from leap_hand.ros.teleop_node import main

if __name__ == "__main__":
    main()

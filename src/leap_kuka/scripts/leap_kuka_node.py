#!/usr/bin/env python3
"""Starts the node that turns the hand over the Leap into the desired tool frame of the arm."""

from leap_kuka.ros.teleop_node import main

if __name__ == "__main__":
    main()

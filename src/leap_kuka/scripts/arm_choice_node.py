#!/usr/bin/env python3
"""Starts the node that chooses which of several arms one hand steers."""

from leap_kuka.ros.arm_choice_node import main

if __name__ == "__main__":
    main()

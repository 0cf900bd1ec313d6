#!/usr/bin/env python3
"""Starts the node that turns a pedal, key, gamepad or service into hold-to-enable and clutch."""

from leap_kuka.ros.operator_input_node import main

if __name__ == "__main__":
    main()

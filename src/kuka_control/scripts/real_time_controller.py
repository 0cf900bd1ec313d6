#!/usr/bin/env python3
"""The real-time controller of the arm."""

from kuka_control.ros.controller_node import real_time_main

real_time_main()

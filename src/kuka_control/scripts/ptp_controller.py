#!/usr/bin/env python3
"""The PTP controller of the arm."""

from kuka_control.ros.controller_node import ptp_main

ptp_main()

#!/usr/bin/env python3
"""Program that lets a trained policy steer."""

from leap_rig.policy.ros.run_program import main

main()

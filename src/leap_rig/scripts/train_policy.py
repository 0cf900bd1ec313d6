#!/usr/bin/env python3
"""Program that trains a policy."""

from leap_rig.policy.ros.train_program import main

main()

#!/usr/bin/env python3
"""Compares grasps in six degrees of freedom by lifting them."""

from grasping.lab.programs.evaluate_poses import main

if __name__ == "__main__":
    main()

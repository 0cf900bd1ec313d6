#!/usr/bin/env python3
"""Finds grasps in one depth image."""

from grasping.lab.programs.find_grasps import main

if __name__ == "__main__":
    main()

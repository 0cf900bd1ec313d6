#!/usr/bin/env python3
"""Finds grasps in depth images."""

from grasping.lab.programs.find_grasps import main

if __name__ == "__main__":
    main()

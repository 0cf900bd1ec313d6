#!/usr/bin/env python3
"""Compares grasp methods on held-out objects."""

from grasping.lab.programs.evaluate import main

if __name__ == "__main__":
    main()

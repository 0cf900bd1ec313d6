#!/usr/bin/env python3
"""Learns from episodes which grasps an operator prefers."""

from grasping.lab.programs.train_refinement import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Compares what predicts an operator's grasps."""

from grasping.lab.programs.evaluate_refinement import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Trains the refinement network on episodes of an operator's grasps."""

from grasping.lab.programs.train_refinement import main

if __name__ == "__main__":
    main()

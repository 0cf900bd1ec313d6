#!/usr/bin/env python3
"""Trains the second network on episodes of a person's grasps."""

from grasping.lab.programs.train_refinement import main

if __name__ == "__main__":
    main()

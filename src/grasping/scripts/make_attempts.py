#!/usr/bin/env python3
"""Tries grasps of synthetic scenes in the physics, to train the network of lifts on."""

from grasping.lab.programs.make_attempts import main

if __name__ == "__main__":
    main()

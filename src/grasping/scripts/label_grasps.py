#!/usr/bin/env python3
"""Draw grasps on depth images with the mouse."""

from grasping.lab.programs.label_grasps import main

if __name__ == "__main__":
    main()

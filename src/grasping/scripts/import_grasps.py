#!/usr/bin/env python3
"""Makes a training set of labelled depth images: Cornell's, Jacquard's, or your own."""

from grasping.lab.programs.import_grasps import main

if __name__ == "__main__":
    main()

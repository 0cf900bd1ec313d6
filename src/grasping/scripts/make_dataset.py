#!/usr/bin/env python3
"""Makes the synthetic data set of the grasp networks."""

from grasping.lab.programs.make_dataset import main

if __name__ == "__main__":
    main()

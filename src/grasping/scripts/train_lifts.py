#!/usr/bin/env python3
"""Trains the network of lifts."""

from grasping.lab.programs.train_lifts import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Trains a grasp network, from nothing or from given weights."""

from grasping.lab.programs.train_ggcnn import main

if __name__ == "__main__":
    main()

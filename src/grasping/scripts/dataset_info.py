#!/usr/bin/env python3
"""Tells what is in a dataset of grasps by an operator."""

from grasping.lab.programs.dataset_info import main

if __name__ == "__main__":
    main()

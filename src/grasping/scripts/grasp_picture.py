#!/usr/bin/env python3
"""Writes what the node ggcnn sees and finds into an image file."""

from grasping.ros.grasp_picture import main

if __name__ == "__main__":
    main()

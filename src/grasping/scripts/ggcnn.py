#!/usr/bin/env python3
"""Looks for grasps in the camera's depth pictures."""

from grasping.ros.ggcnn_node import main

if __name__ == "__main__":
    main()

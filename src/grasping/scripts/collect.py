#!/usr/bin/env python3
"""Records what the camera saw and where a person then grasped."""

from grasping.ros.collection_node import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Lets the arm wait above a proposed grasp for an operator's hand."""

from grasping.ros.execution_node import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Plays a recording for collect.launch."""

from grasping.lab.ros.play_program import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Makes episodes of a simulated operator's grasps."""

from grasping.lab.programs.make_episodes import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Labels grasps in six degrees of freedom by lifting them in the physics."""

from grasping.lab.programs.label_poses import main

if __name__ == "__main__":
    main()

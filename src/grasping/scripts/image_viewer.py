#!/usr/bin/env python3
"""Shows image topics in a window, chosen from a list; image:=TOPIC is shown first."""

from grasping.ros.image_viewer import main

if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Looks for grasps in the camera's depth images."""

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)  # while torch loads there is nothing yet to end in order

from grasping.ros.ggcnn_node import main  # noqa: E402

if __name__ == "__main__":
    main()

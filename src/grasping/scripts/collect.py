#!/usr/bin/env python3
"""Records what the camera saw and where an operator then grasped."""

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)  # while torch loads there is nothing yet to end in order

from grasping.lab.ros.collection_node import main  # noqa: E402

if __name__ == "__main__":
    main()

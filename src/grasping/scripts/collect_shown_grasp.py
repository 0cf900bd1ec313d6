#!/usr/bin/env python3
"""Records maps of a thing with the arm at home, then the tool's poses while an operator holds it at the grasp."""

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)  # while torch loads there is nothing yet to end in order

from grasping.lab.ros.shown_grasp_program import main  # noqa: E402

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    main()

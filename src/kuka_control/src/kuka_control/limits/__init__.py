"""Limits of the motion: servo goals within speed, acceleration, jerk and the workspace; jumps of the stream.

Each is one cycle of a stateful filter or a check; time is handed in.
"""

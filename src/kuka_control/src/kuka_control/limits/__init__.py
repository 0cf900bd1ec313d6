"""Limits of the motion: servo goals within speed, acceleration, jerk and the workspace."""

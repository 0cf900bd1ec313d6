"""Calibration of the camera pose: where the arm shows the marker board, robot-world/hand-eye least squares, and whether
the result may be used."""

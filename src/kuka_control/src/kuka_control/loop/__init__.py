"""The control loops, real time and PTP. Pure: the robot stands behind one interface, and time is handed in."""

"""The control loops, real time and PTP, with what goes into a cycle and what comes out of it.

Pure: the robot stands behind one interface, and time is handed in.
"""

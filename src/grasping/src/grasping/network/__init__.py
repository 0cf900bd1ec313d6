"""From a depth image to grasp maps: pre-processing, GG-CNN and the refinement network, and their weight files.

Numpy, OpenCV and torch; nothing here knows the camera's pose or the robot.
"""

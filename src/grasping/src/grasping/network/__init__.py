"""From a depth image to grasp maps: pre-processing, GG-CNN and its weight files.

Numpy, OpenCV and torch; nothing here knows the camera's pose or the robot.
"""

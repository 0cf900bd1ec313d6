"""The ROS edge of vision: nodes and programs, in the same rooms as the pure code."""

"""The ROS edge of the detector: parameters, messages, nodes."""

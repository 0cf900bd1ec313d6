"""The ROS edge of vision."""

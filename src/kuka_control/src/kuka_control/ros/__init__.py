"""The ROS edge of the controllers and of the control panel."""

"""The ROS edge of leap_hand."""

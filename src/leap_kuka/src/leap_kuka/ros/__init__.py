"""The ROS edge of leap_kuka."""

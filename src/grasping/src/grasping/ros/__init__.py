"""The ROS edge of grasping."""

"""The ROS side of the demo: starts the launch files, listens to the rig, stops it."""

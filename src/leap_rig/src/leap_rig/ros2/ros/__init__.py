"""The node ros2_bridge, which speaks ROS 1, and its other half `side`, which speaks ROS 2."""

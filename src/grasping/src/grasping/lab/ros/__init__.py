"""ROS around the laboratory: the node that records grasp episodes."""

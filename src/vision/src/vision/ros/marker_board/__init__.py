"""ROS edge of the marker board: detections, images of a view, the node plane_pose and its evaluation."""

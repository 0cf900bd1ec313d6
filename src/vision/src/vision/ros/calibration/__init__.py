"""ROS edge of the calibration: the program calibrate_camera, the stored calibrations and the node camera_place."""

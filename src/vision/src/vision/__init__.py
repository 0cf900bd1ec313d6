"""Camera, calibration of the camera to the arm, depth, and the view for the headset."""

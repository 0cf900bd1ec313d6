"""Hands in front of a webcam, served as the Leap service does: `rosrun leap_motion webcam_leapd.py`. `palm_pose`
estimates the metric hand, `setups` brings it into Leap axes, `hand_tracks` keeps ids and judges what can be trusted.
Needs the extra `webcam` of this package (OpenCV, MediaPipe, PyYAML; Qt for the window)."""

"""ROS edge of the headset view: images from topics, the window, and the web page."""

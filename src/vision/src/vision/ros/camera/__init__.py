"""ROS edge of the camera: driver, frames, watchdog, and registration of depth to colour."""

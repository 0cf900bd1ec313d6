"""AprilTag detection with the PyPI package `apriltag`: tag corners, target poses with covariances, and the refinement
of a pose by all grey values. The nodes that publish them are in `ros/`."""

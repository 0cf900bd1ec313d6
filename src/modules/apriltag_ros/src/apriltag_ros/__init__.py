"""AprilTags: detection with the PyPI package apriltag, poses with covariances, and the nodes that publish them."""

"""What every package of the rig shares: rotations and poses, averaging, typed configuration, errors."""

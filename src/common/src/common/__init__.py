"""What every package of the rig shares: rotations and poses, typed configuration, errors."""

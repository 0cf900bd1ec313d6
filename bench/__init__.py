"""Benchmarks of the rig: `make bench`. Nothing here is part of the rig or of its tests' verdict."""

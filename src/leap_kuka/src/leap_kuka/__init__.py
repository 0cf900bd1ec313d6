"""Teleoperation of the arm: from the tracked hand of the operator to the desired tool frame."""

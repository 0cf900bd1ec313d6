"""Teleoperation of the ReFlex hand: from the tracked fingers of the operator to commands of the robot hand."""

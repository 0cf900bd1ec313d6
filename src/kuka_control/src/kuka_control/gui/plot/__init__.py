"""Plots of the workspace, with matplotlib; no ROS here."""

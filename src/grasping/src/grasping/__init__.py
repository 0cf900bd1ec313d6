"""Grasps proposed by a network from depth images, confirmed and corrected by the operator."""

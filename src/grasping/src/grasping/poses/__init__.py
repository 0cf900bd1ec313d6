"""Grasps in six degrees of freedom: hypotheses from GGCNN's whole maps, and how likely each one lifts."""

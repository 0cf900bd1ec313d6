"""How good grasps are: labels, physics, heuristics to compare with."""

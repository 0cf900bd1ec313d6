"""The marker board on the arm: its drawing, its pose from tags and depth, and the evaluation of that pose."""

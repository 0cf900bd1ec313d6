"""The marker board on the arm: its drawing, its pose from tags and depth, and how far that pose is from the truth."""

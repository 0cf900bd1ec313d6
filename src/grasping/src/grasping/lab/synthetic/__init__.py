"""Random heaps, what a depth camera sees of them, and where they can be grasped."""

"""The dataset of grasps by an operator: what an episode is, its file, its labels, and how it is collected."""

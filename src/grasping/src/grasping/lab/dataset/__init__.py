"""The dataset of grasps by a person: what an episode is, its file, its labels, and how it is collected."""

"""The simulated KUKA Sunrise controller with the toolbox server on it."""

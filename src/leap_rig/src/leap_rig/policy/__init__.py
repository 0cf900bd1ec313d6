"""Policies that are trained on recorded episodes: what they see and say, their network, training and file."""

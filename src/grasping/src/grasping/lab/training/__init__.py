"""Batches, losses and steps of the training."""

"""The nodes of the simulation."""

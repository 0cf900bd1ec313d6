"""Nodes of the operator: view with its markers and sounds, tutorial."""

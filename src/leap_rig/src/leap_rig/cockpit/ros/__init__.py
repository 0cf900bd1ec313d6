"""The cockpit's node."""

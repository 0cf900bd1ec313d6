"""The cockpit: the rig in a browser."""

"""The driver node of the Leap Motion controller."""

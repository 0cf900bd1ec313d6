"""Simulated service of the Leap Motion controller: a person's hand, or a recording, on the service's own WebSocket."""

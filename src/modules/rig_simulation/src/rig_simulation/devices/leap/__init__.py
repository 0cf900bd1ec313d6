"""The simulated service of the Leap Motion controller: what the sensor measures of a hand, sent as JSON frames on the
service's own WebSocket."""

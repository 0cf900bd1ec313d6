"""What a program needs to serve hands as the Leap service does; needs numpy and websockets only. `hand` makes the
record of a hand from its joints, `wire` writes records as messages, `server` sends them."""

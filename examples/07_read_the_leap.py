"""Prints the palms that the Leap Motion service sees."""

import argparse

from leap_motion import LeapClient

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--host", default="127.0.0.1", help="address of the service; here the real and the simulated one")
parser.add_argument("--port", type=int, default=6437)
parser.add_argument("--frames", type=int, default=100)
options = parser.parse_args()

leap = LeapClient(options.host, options.port)
for _ in range(options.frames):
    received = leap.next_frame(timeout=2.0)
    if received is None:
        print(leap.status.sentence)
        break
    for hand in received.frame.hands:
        print(f"{hand.side} palm {hand.palm.round(3)} m, grab {hand.grab:.2f}, confidence {hand.confidence:.2f}")
leap.close()

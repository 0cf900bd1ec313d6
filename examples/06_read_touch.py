"""Zeroes the taxels of the hand, then prints for some seconds which of them are touched; nothing moves."""

import argparse
import time

from reflex import ReflexHand

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--interface", default="lo", help="network interface of the hand; lo is the simulated one")
parser.add_argument("--port", type=int, default=11333)
parser.add_argument("--seconds", type=float, default=3.0)
options = parser.parse_args()

with ReflexHand(options.interface, options.port) as hand:
    hand.calibrate_tactile()
    time.sleep(0.5)
    end = time.monotonic() + options.seconds
    while time.monotonic() < end:
        hand.wait_for_packet()
        rows = zip(("f1", "f2", "f3"), hand.state.contact)
        print("touched:", [f"{finger}.{i}" for finger, row in rows for i, on in enumerate(row) if on] or "nothing")

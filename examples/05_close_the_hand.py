"""Closes the fingers of the hand and opens them; calibrates them first if that was never done."""

import argparse

from reflex import ReflexHand

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--interface", default="lo", help="network interface of the hand; lo is the simulated one")
parser.add_argument("--port", type=int, default=11333)
options = parser.parse_args()

with ReflexHand(options.interface, options.port) as hand:
    if not hand.calibrated:
        hand.calibrate_fingers()  # the fingers must be open and free
    hand.close()
    print("closed [rad]:", [round(angle, 2) for angle in hand.state.joint_angles])
    hand.open()
    print("open [rad]:", [round(angle, 2) for angle in hand.state.joint_angles])

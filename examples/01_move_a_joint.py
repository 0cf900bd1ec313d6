"""Turns joint 7 of the arm by 10 degrees and back."""

import argparse

import numpy as np

from kst import KstClient, read_joints, run_ptp

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--host", default="127.0.0.1", help="address of the arm's controller; the simulated one")
parser.add_argument("--port", type=int, default=30001)
options = parser.parse_args()

with KstClient.connect(options.host, options.port) as arm:
    start = read_joints(arm)
    for goal in (start + np.radians([0, 0, 0, 0, 0, 0, 10]), start):
        run_ptp(arm, goal, velocity=0.2, report=lambda progress, q: print(f"joint 7 at {np.degrees(q[6]):6.2f} deg"))

"""Streams 2 s of smooth goals for joint 7 and prints how far the arm lags behind."""

import argparse
import time

import numpy as np

from kst import Feedback, KstClient

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--host", default="127.0.0.1", help="address of the arm's controller; the simulated one")
parser.add_argument("--port", type=int, default=30001)
options = parser.parse_args()

with KstClient.connect(options.host, options.port) as arm:
    arm.start_joint_servo()
    start, begin, lag = arm.joints(), time.monotonic(), 0.0
    while (t := time.monotonic() - begin) < 2.0:
        goal = start + np.radians([0, 0, 0, 0, 0, 0, 5]) * np.sin(0.5 * np.pi * t) ** 2
        lag = max(lag, abs(goal - arm.servo(goal, Feedback.JOINTS)).max())
        time.sleep(0.004)
    arm.stop_joint_servo()
    print(f"largest lag: {np.degrees(lag):.2f} deg")

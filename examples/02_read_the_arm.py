"""Prints joints, flange pose, torques and force of the arm; nothing moves."""

import argparse

import numpy as np

from kst import KstClient

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--host", default="127.0.0.1", help="address of the arm's controller; the simulated one")
parser.add_argument("--port", type=int, default=30001)
options = parser.parse_args()

with KstClient.connect(options.host, options.port) as arm:
    print("joints [deg]:", np.degrees(arm.joints()).round(2))
    print("flange in the base [m]:", arm.pose()[:3, 3].round(4))
    print("external torques [Nm]:", arm.external_torques().round(2))
    print("force at the flange [N]:", arm.force().round(2))

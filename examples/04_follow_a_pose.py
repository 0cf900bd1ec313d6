"""Moves the flange on a circle of 4 cm in 4 s: inverse kinematics for each pose, servo for the joints."""

import argparse
import time

import numpy as np

from iiwa_kinematics import Kinematics, robot_model
from kst import Feedback, KstClient, run_ptp

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--host", default="127.0.0.1", help="address of the arm's controller; the simulated one")
parser.add_argument("--port", type=int, default=30001)
options = parser.parse_args()

kinematics = Kinematics(robot_model("LBR7R800", "MF_elektrisch"))
q = np.radians([0, 25, 0, -80, 0, 75, 0])
T_centre = kinematics.forward(q)
with KstClient.connect(options.host, options.port) as arm:
    run_ptp(arm, q, velocity=0.15)
    arm.start_joint_servo()
    begin = time.monotonic()
    while (t := time.monotonic() - begin) < 4.0:
        angle = 2 * np.pi * (3 * (t / 4) ** 2 - 2 * (t / 4) ** 3)  # starts and ends slowly
        T = T_centre.copy()
        T[:2, 3] += 0.02 * np.array([np.cos(angle) - 1, np.sin(angle)])
        q = kinematics.inverse(T, q).q
        measured = arm.servo(q, Feedback.JOINTS)
        time.sleep(0.004)
    arm.stop_joint_servo()
    off = np.linalg.norm(kinematics.forward(arm.joints())[:3, 3] - T_centre[:3, 3])
print(f"the flange is {1000 * off:.1f} mm from its start")

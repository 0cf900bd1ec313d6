"""Finds joints for a pose of the flange, and says why there are none for a pose that is out of reach."""

import numpy as np

from iiwa_kinematics import Kinematics, robot_model

kinematics = Kinematics(robot_model("LBR7R800", "MF_elektrisch"))
q_seed = np.radians([0, 25, 0, -80, 0, 75, 0])
T = kinematics.forward(q_seed)
for x in (0.0, 0.1, 1.0):
    target = T.copy()
    target[0, 3] += x
    result = kinematics.inverse(target, q_seed)
    print(f"{x:.1f} m forward:", result.failure or f"joints {np.degrees(result.q).round(2)} deg")

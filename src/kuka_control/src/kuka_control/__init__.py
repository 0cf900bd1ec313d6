"""The control nodes of the KUKA arm: its model, the limits of its motion, the control loops, nodes and windows.

Rooms, each above the one before: `model`, `limits`, `loop`, then `gui` and `ros`; `kinematics` stands below all.
"""

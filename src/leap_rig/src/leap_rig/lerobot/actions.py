"""An action of a LeRobot policy: the tool's pose in kuka/base_frame, and the angles of the hand's motors. What becomes
of it is leap_kuka's matter (jumps, hands, enabling), and then that of the controller, as of any desired tool."""

from __future__ import annotations

import math
from collections.abc import Mapping

from common.robot_hand import HAND
from leap_rig.recording.episode import ARM as JOINTS

POSE = tuple(f"tool.{part}" for part in ("x", "y", "z", "qx", "qy", "qz", "qw"))
FINGERS = tuple(f"{motor}.pos" for motor in HAND.motors)
ACTION = POSE + FINGERS
STATE = (*(f"{name}.pos" for name in JOINTS), *(f"{name}.torque" for name in JOINTS), *FINGERS, *POSE)
SILENT_S, SLOW_S = 0.5, 3.0  # what a measurement may be old; torques and images: a busy machine renders few
FARTHEST_M, LARGEST_RAD = 2.0, 4.0  # of the base; of a motor
HOLDS_S = 0.3  # an action, unless the next one comes
NORM_TOLERANCE = 0.3  # of a quaternion: networks say none of length 1


def action_fault(action: Mapping[str, object]) -> str:
    """Returns why this is no action, a sentence; empty if it is one."""
    if action.keys() != set(ACTION):
        wrong = sorted(set(ACTION) ^ action.keys())
        return f"The action needs {', '.join(ACTION)} and nothing else; look at {', '.join(wrong)}."
    for name, value in action.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            return f"The action has {name}: {value!r}, which is not a finite number."
    x, y, z, *q = (float(str(action[name])) for name in POSE)
    if math.hypot(x, y, z) > FARTHEST_M:
        return f"The action is {math.hypot(x, y, z):.3g} m from the base, more than {FARTHEST_M:g} m."
    if abs(math.hypot(*q) - 1.0) > NORM_TOLERANCE:
        return f"The action's quaternion has the length {math.hypot(*q):.3g}, not about 1."
    for name in FINGERS:
        if abs(float(str(action[name]))) > LARGEST_RAD:
            return f"The action has {name}: {action[name]} rad, more than {LARGEST_RAD:g} rad."
    return ""

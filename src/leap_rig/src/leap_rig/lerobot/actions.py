"""Actions of a policy, a few in a second, as a stream of desired tools within reach of where the tool is.

An action names the tool's pose in kuka/base_frame and the angles of the hand's motors. A stream begins at the measured
tool, follows the newest action no faster than the limits here, and pauses when no action comes. What the arm then does
is the controller's matter: limits, workspace, guard and watchdog are those of any desired tool."""

from __future__ import annotations

import math
from collections.abc import Mapping

from common.robot_hand import HAND
from leap_rig.cockpit.frame_poses import Pose7, angle_between

POSE = tuple(f"tool.{part}" for part in ("x", "y", "z", "qx", "qy", "qz", "qw"))
FINGERS = tuple(f"{motor}.pos" for motor in HAND.motors)
ACTION = POSE + FINGERS
FARTHEST_M, LARGEST_RAD = 2.0, 4.0  # of the base; of a motor
JUMP_M, JUMP_RAD = 0.15, 0.6  # an action farther from the tool as it is desired now is refused
SPEED_M_S, SPEED_RAD_S = 0.25, 1.0
STALE_S = 0.5  # after an action
NORM_TOLERANCE = 0.01  # of a quaternion


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
        return f"The action's quaternion has the length {math.hypot(*q):.3g} instead of 1."
    for name in FINGERS:
        if abs(float(str(action[name]))) > LARGEST_RAD:
            return f"The action has {name}: {action[name]} rad, more than {LARGEST_RAD:g} rad."
    return ""


class ActionStream:
    """The desired tool that follows actions; times in s, monotonic."""

    def __init__(self) -> None:
        self._target: Pose7 | None = None
        self._tool: Pose7 = ()
        self._taken = self._stepped = -math.inf

    def take(self, action: Mapping[str, float], measured: Pose7 | None, now: float) -> str:
        """Takes an action; returns why it does not, a sentence, or nothing. `measured`: the tool as it is."""
        fault = action_fault(action)
        if fault:
            return fault
        if self._target is None or now - self._taken > STALE_S:
            if measured is None:
                return "Nothing says where the tool is, so no action is taken."
            self._tool, self._stepped = measured, now
        x, y, z, *q = (float(action[name]) for name in POSE)
        target = (x, y, z, *(part / math.hypot(*q) for part in q))
        off, turned = math.dist(target[:3], self._tool[:3]), angle_between(target, self._tool)
        if off > JUMP_M or turned > JUMP_RAD:
            return (
                f"The action is {1e3 * off:.0f} mm and {math.degrees(turned):.0f} deg from the tool, more than "
                f"{1e3 * JUMP_M:.0f} mm or {math.degrees(JUMP_RAD):.0f} deg, so the tool stays."
            )
        self._target, self._taken = target, now
        return ""

    def step(self, now: float) -> Pose7 | None:
        """Returns the desired tool of now; None while no action is younger than STALE_S."""
        if self._target is None or now - self._taken > STALE_S:
            self._target = None
            return None
        passed, self._stepped = max(0.0, now - self._stepped), now
        off, turned = math.dist(self._target[:3], self._tool[:3]), angle_between(self._target, self._tool)
        parts = [most * passed / left for most, left in ((SPEED_M_S, off), (SPEED_RAD_S, turned)) if left > 0.0]
        part = min([1.0, *parts])
        self._tool = between(self._tool, self._target, part)
        return self._tool


def between(a: Pose7, b: Pose7, part: float) -> Pose7:
    """Returns the pose a `part`, 0 to 1, of the way from a to b."""
    dot = sum(p * q for p, q in zip(a[3:], b[3:]))
    side, half = (1.0 if dot >= 0.0 else -1.0), math.acos(min(1.0, abs(dot)))
    if half < 1e-6:
        weights = 1.0 - part, part
    else:
        weights = math.sin((1.0 - part) * half) / math.sin(half), math.sin(part * half) / math.sin(half)
    q = [weights[0] * p + weights[1] * side * r for p, r in zip(a[3:], b[3:])]
    length = math.hypot(*q)
    return (*((1.0 - part) * p + part * r for p, r in zip(a[:3], b[:3])), *(one / length for one in q))

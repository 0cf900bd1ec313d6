"""The published mode of a controller."""

from __future__ import annotations

from enum import Enum


class Mode(str, Enum):
    """The mode on kuka/mode and in kuka/status; rig_msgs/KukaStatus has the same constants."""

    STARTING = "starting"
    HOMING = "homing"
    HOME = "home"
    PICK_UP = "pick_up"
    SERVO = "servo"
    RETURNING = "returning"
    ZERO = "zero"
    STOPPED = "stopped"

"""The modes of an arm's controller on kuka/mode and in kuka/status (rig_msgs/KukaStatus has the same constants), and
the states of a grasp's execution on grasping/state."""

from __future__ import annotations

from enum import Enum


class Mode(str, Enum):
    """A mode; it compares equal to its text in a message."""

    STARTING = "starting"
    HOMING = "homing"
    HOME = "home"
    PICK_UP = "pick_up"
    SERVO = "servo"
    RETURNING = "returning"
    ZERO = "zero"
    MOVING = "moving"
    HOLDING = "holding"
    STOPPED = "stopped"


TO_DESIRED_TOOL = (Mode.PICK_UP.value, Mode.SERVO.value)  # the arm goes to the desired tool frame, or follows it
FOLLOWS_TOOL = (Mode.HOME.value, *TO_DESIRED_TOOL)  # the same, or it would as soon as the frame comes
LEAVES_TOOL = (Mode.RETURNING.value, Mode.HOMING.value, Mode.HOME.value)  # it leaves the frame, or has
CANNOT_FOLLOW = (Mode.STARTING.value, Mode.ZERO.value, Mode.STOPPED.value)  # whatever frame comes


class ExecutionState(str, Enum):
    """A state of the execution of a proposed grasp; it compares equal to its text in a message."""

    IDLE = "idle"  # no grasp was executed yet
    APPROACHING = "approaching"  # the arm goes before the grasp
    WAITING_FOR_HAND = "waiting_for_hand"  # the tool is held there
    PERSON = "person"  # an operator's hand steers
    OVER = "over"

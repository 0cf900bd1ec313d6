"""From the message reflex_msgs/Hand to this package's record."""

from __future__ import annotations

from leap_hand.force_limit import FEELING, HandState


def state_from_hand(hand) -> HandState:
    """Returns what the robot hand felt: index, middle, thumb of a reflex_msgs/Hand message."""
    motors = hand.motor[: len(FEELING)]
    return HandState(
        angles=tuple(motor.joint_angle for motor in motors),
        pressures=tuple(tuple(finger.pressure) for finger in hand.finger),
        loads=tuple(motor.load for motor in motors),
    )

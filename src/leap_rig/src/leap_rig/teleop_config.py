"""Private parameters of the node leap_teleop, beside those of leap_driver and leap_hand_node in their sections."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import names

DRIVER, HAND = "driver", "hand"
"""The sections of the private parameters: those of leap_driver, and of leap_hand_node."""


@dataclass(frozen=True)
class LeapTeleopConfig:
    """Of the node itself."""

    arms: tuple[str, ...] = names(
        doc="namespaces of several arms, such as [left, right]; a robot hand then follows the hand of leap/hand there",
        absent=(),
    )

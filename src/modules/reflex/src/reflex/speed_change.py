"""Setting the servos' speed takes three packets with pauses between them; this says which one is due when.

The hand reads targets as speeds while it is in velocity mode, in which torque is off. Pure: time [s] is handed in.
"""

from __future__ import annotations

from collections.abc import Sequence

from reflex.codec import POSITION, VELOCITY, encode_mode, encode_target
from reflex.conversions import speed_units

PAUSES_S = (0.020, 0.035, 0.035)


class SpeedChange:
    """One change of the four speeds.

    Args:
        speeds: joint speeds [rad/s] of f1, f2, f3, preshape.
        now: when it begins [s].

    Raises:
        ValueError: a speed is not finite.
    """

    def __init__(self, speeds: Sequence[float], now: float) -> None:
        units = [speed_units(i, speed) for i, speed in enumerate(speeds)]
        self._packets = [encode_mode(VELOCITY), encode_target(units), encode_mode(POSITION)]
        self._pauses = list(PAUSES_S)
        self._due = now
        self.done = False

    def step(self, now: float) -> tuple[bytes, ...]:
        """Returns the packet that is due, if one is; `done` is true one pause after the last."""
        if now < self._due:
            return ()
        if not self._packets:
            self.done = True
            return ()
        self._due = now + self._pauses.pop(0)
        return (self._packets.pop(0),)

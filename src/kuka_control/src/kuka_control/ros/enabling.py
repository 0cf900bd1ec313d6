"""Whether the operator has let go of what enables the teleoperation, from leap_kuka/state."""

from __future__ import annotations

from collections.abc import Callable

import rospy

from common import clock
from kuka_control.numbers import ENABLING_SILENT_S
from rig_msgs.msg import TeleopState


class EnablingWatch:
    """Calls `released` with the reason, a part of a sentence, when what was pressed is pressed no more. A motion that
    began without it continues."""

    def __init__(self, released: Callable[[str], None]) -> None:
        self._released = released
        self._lock = clock.Lock()
        self._pressed = False
        self._heard = 0.0  # [s]
        rospy.Subscriber("leap_kuka/state", TeleopState, self._take, queue_size=10, tcp_nodelay=True)

    def check(self) -> None:
        """Takes silence for a release; called in each cycle of the control loop."""
        if self._pressed and clock.monotonic() - self._heard > ENABLING_SILENT_S:
            self._set(False, f"leap_kuka/state, which told that it is enabled, is silent for {ENABLING_SILENT_S:g} s")

    def _take(self, message: TeleopState) -> None:
        self._heard = clock.monotonic()
        self._set(message.enabling_needed and message.enabled, "the enabling device was released")

    def _set(self, pressed: bool, why: str) -> None:
        with self._lock:
            before, self._pressed = self._pressed, pressed
        if before and not pressed:
            self._released(why)

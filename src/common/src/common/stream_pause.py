"""The pause that divides two streams of desired tool frames, as their receiver and their sender count it. The
controller of the arm (kuka_control) takes frames after a longer pause for a new stream, which the arm goes to by a
motion of its own; what steers the arm (leap_kuka) must not begin anew before. Whoever changes one changes both."""

from __future__ import annotations

from typing import Final

NEW_STREAM_PAUSE_S: Final = 0.28  # the controller: longer than one lost packet stops TCP (0.2 s)
DELAY_S: Final = 0.02  # on the way
SENDER_PAUSE_S: Final = NEW_STREAM_PAUSE_S + DELAY_S  # who sends waits so long before it begins anew

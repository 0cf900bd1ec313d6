"""Numbers of the robot hand's teleoperation that a user or a reviewer must know; what a user may set is in
config.py. Times in seconds of a monotonic clock."""

from __future__ import annotations

from typing import Final

from common.numbers import HAND_LOST_S

MAX_SILENCE_S: Final = 0.5  # without a usable frame for longer the hand opens, once
MAX_MISSING_S: Final = HAND_LOST_S  # longest time without the owner of a lock that is made here, as with the arm
NEAR: Final = 0.15  # of a finger's range: so near to the kept command the operator's finger takes over
FIRST_STATE_S: Final = 2.0  # longest wait for the first state of the robot hand
ANSWER_TIMEOUT_S: Final = 10.0  # of the services that calibrate the robot hand
SETTLING_S: Final = 2.0  # they answer at once and the fingers move on; a command would fight the calibration
MIN_LENGTH_M: Final = 1e-3  # between two points of a hand; a shorter vector has no direction

# The measurement of a person's hand.
HOLD_S: Final = 0.7  # time for which the hand must be still
MAX_GAP_S: Final = 0.15  # longest gap in the tracking meanwhile
LEAST_REACH_M: Final = 0.045  # from the palm centre to the tip of the middle finger of an open hand
MOST_REACH_M: Final = 0.17
HINT_S: Final = 3.0  # a hint is said again after this long

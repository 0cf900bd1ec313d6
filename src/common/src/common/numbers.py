"""Numbers that several packages share. Those of one package stand in its own numbers.py; leap_motion stands alone and
has its own copies (tests/test_shared_numbers.py)."""

from __future__ import annotations

from typing import Final

HAND_LOST_S: Final = 0.2  # an engagement, or the hand that the fingers follow, ends without its hand for longer
LEAST_RATE_HZ: Final = 20.0  # frames that come less often steer no arm
STAMP_SKEW_S: Final = 0.5  # farthest that the stamp of a frame may be from the clock
FAR_TOOL_M: Final = 5.0  # a tool farther from the base was not meant in metres
LABEL_M: Final = 0.045  # height of a line of text in RViz: 17 pixels in its smallest window, seen from 2.2 m
SWITCH_INTERVAL_S: Final = 5e-4  # a control loop waits at most this long for another thread of its process

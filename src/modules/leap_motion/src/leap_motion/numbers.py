"""Numbers of the arm's teleoperation that a tracker must know. This package stands alone, so they stand here again;
tests/test_shared_numbers.py compares them."""

from __future__ import annotations

from typing import Final

KEPT_S: Final = 0.2  # a hand that was not seen for longer is lost, as in leap_kuka
SETTLE_S: Final = 0.3  # no hands after their axes were placed anew: longer than any engagement outlives its hand
ENOUGH_RATE_HZ: Final = 24.0  # from this frame rate on leap_kuka lets a hand steer

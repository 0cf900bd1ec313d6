"""When a frame was taken: its time on the device's clock, brought to the receiver's. Frames wait in the service, the
network and this process, some longer than others. By their times of receipt the frames of a burst would be a few
milliseconds apart, and a hand that moved steadily would jump."""

from __future__ import annotations

import math
from collections import deque

WINDOW_S = 1.0  # the least delayed frame of so long ties the clocks; a clock that is 1 % too slow costs 10 ms then
MAX_WAIT_S = 0.1  # no frame counts as older


class DeviceClock:
    """Compares two clocks frame by frame. The least delayed of the recent frames counts as not delayed."""

    def __init__(self) -> None:
        self._device = -math.inf  # time of the newest frame on the device's clock [s]
        self._taken = -math.inf  # the same on the receiver's [s]
        # Times of receipt [s], and how far they are ahead of the device's [s].
        self._ahead: deque[tuple[float, float]] = deque()

    def waited(self, timestamp_us: int, received: float) -> float:
        """Returns how long a frame waited, `timestamp_us` by the device and `received` [s] by the receiver [s].
        Frames stay in their order. A device that repeats its time or restarts, and a clock that is set, tell
        nothing: then the frame has not waited."""
        leap_s = 0.5  # a frame that seems to have waited longer came after one of the clocks was set
        device, before = 1e-6 * timestamp_us, self._device
        self._device = device
        if not 0.0 < device - before <= WINDOW_S or received <= self._taken:
            self._ahead.clear()
            self._taken = min(received, self._taken)
        self._ahead.append((received, received - device))
        while received - self._ahead[0][0] > WINDOW_S:
            self._ahead.popleft()
        waited = received - device - min(ahead for _, ahead in self._ahead)
        if waited > leap_s:
            self._ahead = deque([(received, received - device)])
            waited = 0.0
        waited = min(waited, MAX_WAIT_S)
        if received - waited <= self._taken:
            waited = 0.0
        self._taken = received - waited
        return waited

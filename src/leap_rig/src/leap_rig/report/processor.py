"""How busy the processors of this machine are, all programs together, from /proc/stat."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path


def cpu_times(stat: str) -> tuple[int, int]:
    """Returns from the text of /proc/stat the time in use and the whole time, summed over all processors [ticks]."""
    idle = 3  # column of a line of /proc/stat: time without work
    waiting = 4  # time in which only a disk is waited for
    ticks = [int(word) for word in stat.split("\n", 1)[0].split()[1:9]]
    return sum(ticks) - ticks[idle] - ticks[waiting], sum(ticks)


class ProcessorLoad:
    """Samples the load once a second; `read` returns the text of /proc/stat."""

    def __init__(self, read: Callable[[], str] = Path("/proc/stat").read_text) -> None:
        self._read = read
        self._before: tuple[int, int] | None = None
        self._next = 0.0

    def sample(self, now: float) -> float | None:
        """Returns the fraction of all processors in use since the last sample, None between samples; `now` [s]."""
        sample_s = 1.0
        if now < self._next:
            return None
        self._next = now + sample_s
        try:
            times = cpu_times(self._read())
        except (OSError, ValueError, IndexError):  # another kernel: the report then says nothing of the processor
            return None
        before, self._before = self._before, times
        if before is None or times[1] <= before[1]:
            return None
        return (times[0] - before[0]) / (times[1] - before[1])

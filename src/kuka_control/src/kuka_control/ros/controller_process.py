"""The controller's process on this machine: found by the number it reports, and ended only if it still is that process.

Numbers of processes are used again. What belongs to one process alone is its number together with its start time.
"""

from __future__ import annotations

import contextlib
import os
import signal
from dataclasses import dataclass
from pathlib import Path

PROGRAM = "controller"
"""Part of the file name of every program that may be ended."""


@dataclass(frozen=True)
class ControllerProcess:
    """A process of this machine; `start` is its start time in clock ticks since the machine started."""

    pid: int
    start: int


def find(pid: int) -> ControllerProcess | None:
    """Returns the running process `pid`, or None if it does not run or is not a controller."""
    start = _start_of(pid)
    if start is None or not _is_controller(pid):
        return None
    return ControllerProcess(pid, start)


def runs(process: ControllerProcess) -> bool:
    """Tells whether this very process still runs; one that is stopped or hangs does."""
    return _start_of(process.pid) == process.start


def kill(process: ControllerProcess) -> None:
    """Kills the process; does nothing if it has exited.

    Raises:
        PermissionError: the process belongs to another user.
    """
    if runs(process):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)


def _start_of(pid: int) -> int | None:
    """Returns the start time of a process [clock ticks], None if it has ended (proc(5), field 22 of stat)."""
    if pid <= 0:
        return None
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(errors="replace")
    except OSError:
        return None
    fields = stat[stat.rindex(")") + 1 :].split()  # the name before it may hold spaces and brackets
    state, start = fields[0], fields[19]
    return None if state in "ZX" else int(start)  # a zombie has ended, its parent has not looked yet


def _is_controller(pid: int) -> bool:
    try:
        arguments = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    return any(PROGRAM in os.path.basename(os.fsdecode(argument)) for argument in arguments)

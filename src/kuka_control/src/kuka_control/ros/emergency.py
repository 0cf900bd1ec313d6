"""The Emergency Stop of the control panel: asks the controller to exit at once, and kills its process if it hangs.
The process is found by the number that it reports. Numbers are used again, so what identifies it is its number
together with its start time."""

from __future__ import annotations

import contextlib
import os
import signal
from dataclasses import dataclass
from pathlib import Path

from common import clock
from common.ros.service_calls import ServiceAbsent, ServiceClient, ServiceFailed

PROGRAM = "controller"  # part of the file name of every program that may be ended
SERVICE = "kuka/exit_app_emergency"
PATIENCE_S = 0.5  # how long the controller may take to end by itself
KILL_S = 1.0
SMARTPAD = "Press the red button of the smartPad."


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
    """Kills the process unless it has exited; PermissionError: it belongs to another user."""
    if runs(process):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)


def _start_of(pid: int) -> int | None:
    """Returns the start time of a process [clock ticks], None if it has ended (proc(5), field 22 of stat)."""
    if pid <= 0:
        return None
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:  # a Path would take twice as long, and panels ask often
            stat = file.read()
    except OSError:
        return None
    fields = stat[stat.rindex(b")") + 1 :].split()  # the name before it may hold spaces and brackets
    state, start = fields[0], fields[19]
    return None if state in b"ZX" else int(start)  # a zombie has ended, its parent has not looked yet


def _is_controller(pid: int) -> bool:
    try:
        arguments = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    return any(PROGRAM in os.path.basename(os.fsdecode(argument)) for argument in arguments)


LEFT_BEHIND = "the robot holds its last goal, a motion to a point runs to its end"
"""What becomes of the arm: the toolbox server has no watchdog, and no command that stops such a motion."""
WITHOUT_CLIENT = "the robot stops, as its client is gone"
"""What becomes of it with the robot application."""
TOLD_TO_STOP = "the robot was told to stop"


def stop(
    call_exit: ServiceClient, process: ControllerProcess | None, host: str, stops: bool = False
) -> tuple[bool, str]:
    """Stops the controller; returns within about half a second whether it is known to have exited, and a sentence.
    `process` is the controller's if it runs on this machine and was verified; `host` is empty if it was never heard
    of; `stops`: the robot's application can stop a motion."""
    deadline = clock.monotonic() + PATIENCE_S
    answer, failure = "", None
    try:
        answer = call_exit(timeout=PATIENCE_S).message
    except ServiceFailed as error:
        failure = error
    if process is not None:
        left_behind = WITHOUT_CLIENT if stops else LEFT_BEHIND
        told = TOLD_TO_STOP if TOLD_TO_STOP in answer else left_behind
        return _end(process, deadline if failure is None else 0.0, told, left_behind)
    if failure is None:
        return True, f"Emergency Stop: {answer}"
    if not host and isinstance(failure, ServiceAbsent):
        return False, f"Emergency Stop: there is no controller to stop; {failure}."
    where = f" on {host}" if host else ""
    return False, f"Emergency Stop: the controller{where} did not confirm it. {SMARTPAD}"


def _end(process: ControllerProcess, deadline: float, told: str, left_behind: str) -> tuple[bool, str]:
    if _ended(process, deadline):
        return True, f"Emergency Stop: the controller has exited; {told}."
    try:
        kill(process)
    except PermissionError:
        return False, f"Emergency Stop: process {process.pid} belongs to another user. {SMARTPAD}"
    if _ended(process, clock.monotonic() + KILL_S):
        return True, f"Emergency Stop: the controller hung and its process was ended; {left_behind}."
    return False, f"Emergency Stop: process {process.pid} cannot be ended. {SMARTPAD}"


def _ended(process: ControllerProcess, deadline: float) -> bool:
    poll_s = 0.01
    while runs(process):
        if clock.monotonic() >= deadline:
            return False
        clock.sleep(poll_s)
    return True

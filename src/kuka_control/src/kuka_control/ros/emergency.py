"""The Emergency Stop of the control panel: asks the controller to exit at once, and kills its process if it hangs."""

from __future__ import annotations

import time

from common.ros.service_calls import ServiceAbsent, ServiceClient, ServiceFailed
from kuka_control.ros import controller_process
from kuka_control.ros.controller_process import ControllerProcess

SERVICE = "kuka/exit_app_emergency"
PATIENCE_S = 0.5
"""How long the controller may take to end by itself."""
KILL_S = 1.0
POLL_S = 0.01
LEFT_BEHIND = "the robot holds its last goal, a motion to a point runs to its end"
"""What becomes of the arm: the toolbox server has no watchdog, and no command that stops such a motion."""
SMARTPAD = "Press the red button of the smartPad."


def stop(call_exit: ServiceClient, process: ControllerProcess | None, host: str) -> tuple[bool, str]:
    """Stops the controller; returns within about half a second whether it is known to have exited, and a sentence.

    Args:
        call_exit: the client of the service.
        process: the controller's process if it runs on this machine and was verified.
        host: name of the machine on which it runs, empty if it was never heard of.
    """
    deadline = time.monotonic() + PATIENCE_S
    answer, failure = "", None
    try:
        answer = call_exit(timeout=PATIENCE_S).message
    except ServiceFailed as error:
        failure = error
    if process is not None:
        return _end(process, deadline if failure is None else 0.0)
    if failure is None:
        return True, f"Emergency Stop: {answer}"
    if not host and isinstance(failure, ServiceAbsent):
        return False, f"Emergency Stop: there is no controller to stop; {failure}."
    where = f" on {host}" if host else ""
    return False, f"Emergency Stop: the controller{where} did not confirm it. {SMARTPAD}"


def _end(process: ControllerProcess, deadline: float) -> tuple[bool, str]:
    if _ended(process, deadline):
        return True, f"Emergency Stop: the controller has exited; {LEFT_BEHIND}."
    try:
        controller_process.kill(process)
    except PermissionError:
        return False, f"Emergency Stop: process {process.pid} belongs to another user. {SMARTPAD}"
    if _ended(process, time.monotonic() + KILL_S):
        return True, f"Emergency Stop: the controller hung and its process was ended; {LEFT_BEHIND}."
    return False, f"Emergency Stop: process {process.pid} cannot be ended. {SMARTPAD}"


def _ended(process: ControllerProcess, deadline: float) -> bool:
    """Waits until the process has ended, at most until the deadline."""
    while controller_process.runs(process):
        if time.monotonic() >= deadline:
            return False
        time.sleep(POLL_S)
    return True

"""The control panel that comes with a controller: a program of its own, on which no motion depends."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator

import rosgraph
import rospy

from common.errors import ConfigError, RigError
from common.ros.service_calls import MasterLost, ask_master, listens
from common.screen import no_screen

NODE = "kuka_panel"
WITHOUT = "Its buttons are services, such as `rosservice call kuka/kuka_control true`."
END_S = 3.0  # how long a panel may take to close


@contextlib.contextmanager
def control_panel() -> Iterator[None]:
    """Opens the control panel beside a controller unless its command line says gui:=false, and closes it with the
    controller. After a fault, or if the controller is killed, the panel stays and shows the last state. Raises
    ConfigError: gui is neither true nor false."""
    process = _open() if _wanted() else None
    try:
        yield
    finally:
        if process is not None and not isinstance(sys.exc_info()[1], RigError):
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)


def why_not() -> str:
    """Returns why a panel that comes with a controller is not opened, a sentence; empty if it can be."""
    name = rosgraph.names.ns_join(rosgraph.names.get_ros_namespace(), NODE)
    with contextlib.suppress(MasterLost):
        address = ask_master("lookupNode", name)
        if address is not None and listens(address):
            return f"The control panel is open already (node {name}); a second one is not opened."
    fault = no_screen()
    return fault and f"The control panel is not opened: {fault}. {WITHOUT}"


def _wanted() -> bool:
    given = rosgraph.names.load_mappings(sys.argv).get("gui", "true").lower()
    if given not in ("true", "false", "1", "0"):
        raise ConfigError([f"gui:={given} is neither true nor false."])
    return given in ("true", "1")


def _open() -> subprocess.Popen | None:
    fault = "" if os.environ.get("DISPLAY") else no_screen()  # the panel itself asks the screen, and its master
    if fault:
        rospy.loginfo("The control panel is not opened: %s. %s", fault, WITHOUT)
        return None
    command = ["rosrun", "kuka_control", "gui.py", "--on-top", "--if-possible"]
    try:
        # Ctrl-C in the terminal reaches the controller alone, which closes the panel at its end.
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    except OSError as error:
        rospy.logwarn("The control panel does not start: %s. %s", error.strerror, WITHOUT)
        return None

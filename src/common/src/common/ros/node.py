"""The life of a node: start, run, and end with one sentence instead of a traceback."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator

import rospy

from common.errors import ConfigError, RigError

CLOCK_S = 10.0
CLOCK_POLL_S = 0.05


def run(name: str, main: Callable[[], None]) -> None:
    """Starts the node `name`, runs `main` to its end and exits the process.

    The exit code is 0 when main returns or ROS shuts down, 1 after a RigError: its sentence goes to the log and to the
    standard error stream. Any other exception is a defect of the program and keeps its traceback.
    """
    try:
        rospy.init_node(name)
    except rospy.exceptions.ROSInitException:
        sys.exit(1)  # interrupted before it began
    _shut_down_beside_the_main_thread()
    try:
        _wait_for_clock()
        main()
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():  # then the topics close while main runs
            raise
    except RigError as error:
        for sentence in error.faults if isinstance(error, ConfigError) else [str(error)]:
            rospy.logfatal("%s: %s", rospy.get_name(), sentence)
        rospy.signal_shutdown("fault")
        sys.exit(1)


def _wait_for_clock() -> None:
    """Waits until ROS time is known.

    Raises:
        RigError: time is simulated, and nobody tells it.
        rospy.ROSInterruptException: ROS shut down while waiting.
    """
    deadline = time.monotonic() + CLOCK_S
    while not rospy.rostime.is_wallclock() and rospy.get_rostime().is_zero():
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shut down while waiting for /clock")
        if time.monotonic() > deadline:
            raise RigError(
                f"The parameter use_sim_time is true, but nobody publishes /clock within {CLOCK_S:g} s: play a "
                "recording with --clock, or rosparam set use_sim_time false."
            )
        time.sleep(CLOCK_POLL_S)


def _shut_down_beside_the_main_thread() -> None:
    """Takes SIGINT and SIGTERM out of rospy's hands.

    Its handler closes the topics in the main thread. If that was just publishing, it holds the lock of a topic's queue,
    and the handler waits for that lock for ever: the node neither ends nor goes on.
    """

    def shut_down(number: int, _) -> None:
        threading.Thread(target=rospy.signal_shutdown, args=(f"signal-{number}",), name="shutdown").start()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, shut_down)


@contextlib.contextmanager
def while_running() -> Iterator[None]:
    """For callbacks: a message that is published while ROS shuts down meets a closed topic, which is no fault."""
    try:
        yield
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():  # which is true as soon as the topics close, is_shutdown() later
            raise

"""The life of a node: start, run, and exit with one sentence instead of a traceback."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator

import rospy

from common.errors import ConfigError, RigError

CLOCK_S = 10.0
CLOCK_POLL_S = 0.05


def run(name: str, main: Callable[[], None], disposable: bool = False) -> None:
    """Starts the node `name`, runs `main` and exits the process: with 0 when main returns or ROS shuts down, with 1
    after a RigError, whose sentence goes to the log and to stderr.
    Any other exception is a defect of the program and keeps its traceback.

    A `disposable` process exits as soon as ROS has shut down and the rospy.on_shutdown callbacks are done, wherever
    main is, and without destroying the interpreter's objects. For nodes with torch: both take seconds.
    """
    try:
        rospy.init_node(name)
    except rospy.exceptions.ROSInitException:
        sys.exit(1)  # interrupted before it began
    _shut_down_beside_the_main_thread(disposable)
    code = _code_of(main)
    if disposable:
        rospy.signal_shutdown("main has ended")
        for thread in threading.enumerate():  # one of them may shut ROS down
            if thread is not threading.current_thread() and not thread.daemon:
                thread.join()
        _leave(code)
    if code:
        sys.exit(code)


def _code_of(main: Callable[[], None]) -> int:
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
        return 1
    return 0


def _leave(code: int) -> None:
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the reader is gone
            stream.flush()
    os._exit(code)


def _wait_for_clock() -> None:
    """Waits until ROS time is known; raises a RigError if it is simulated and nobody publishes it."""
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


def _shut_down_beside_the_main_thread(leave: bool) -> None:
    """Takes SIGINT and SIGTERM out of rospy's hands, whose handler closes the topics in the main thread: if that thread
    is publishing, it holds the lock that the handler waits for, and the node hangs.
    With `leave` the process exits afterwards.
    """

    def shut_down(reason: str) -> None:
        rospy.signal_shutdown(reason)
        if leave:
            _leave(0)

    threads: list[threading.Thread] = []

    def handle(number: int, _) -> None:
        if not threads:  # a second one would not wait for the first
            threads.append(threading.Thread(target=shut_down, args=(f"signal-{number}",), name="shutdown"))
            threads[0].start()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handle)


@contextlib.contextmanager
def while_running() -> Iterator[None]:
    """For callbacks: ignores that a topic is closed because ROS shuts down."""
    try:
        yield
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():  # which is true as soon as the topics close, is_shutdown() later
            raise

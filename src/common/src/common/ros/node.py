"""The life of a node: start, run, and exit with one sentence instead of a traceback."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import faulthandler
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import rosgraph.xmlrpc
import rospy
import rospy.topics
from rospy.impl.paramserver import get_param_server_cache

from common import clock
from common.errors import ConfigError, DeviceError, RigError
from common.ros import master
from common.ros.files import home

LOG_TOPICS = "/rosout_disable_topics_generation"
UNPRINTABLE = "backslashreplace"  # of a letter that the locale of a terminal lacks, or of a file name in another one
INTERRUPTED = 130  # exit code of a program after Ctrl-C or SIGTERM
END_S = 120.0  # a node that has not ended so long after its signal hangs; roslaunch kills it after 17 s
M_ARENA_MAX = -8  # mallopt(3)
REPEAT_S = 10.0  # the same exception of a callback is logged again after this time [s]


def run(name: str, main: Callable[[], None], disposable: bool = False) -> None:
    """Starts the node `name`, runs `main` and exits the process: with 0 when main returns or ROS shuts down, with 1
    after a RigError, whose sentence goes to the log and to stderr, and when the ROS master was started anew. Any other
    exception is a defect of the program and keeps its traceback. A `disposable` process exits as soon as ROS has shut
    down and the rospy.on_shutdown callbacks are done, wherever main is, and without destroying the interpreter's
    objects. For nodes with torch: both take seconds."""
    prepare_process(disposable)
    try:
        _begin(name, master.PATIENCE_S)
    except RigError as error:
        _report(name, error)
        sys.exit(1)
    master.watch.start()
    code = _code_of(main) or int(master.watch.fault is not None)
    if disposable:
        rospy.signal_shutdown("main has ended")
        leave_after_all_threads(code)
    if code:
        sys.exit(code)


def join(name: str, anonymous: bool = False, argv: list[str] | None = None) -> None:
    """Makes a program a node, whose ROS time is known then; for `run_program`. Raises RigError, with a sentence, if its
    surroundings do not allow it: no ROS master, no clock, ..."""
    _begin(name, 0.0, anonymous=anonymous, argv=argv)
    _wait_for_clock()


def _begin(name: str, patience: float, **options: Any) -> None:
    master.check_surroundings()
    master.check_master(patience)
    try:
        rospy.init_node(name, disable_signals=True, **options)
    except rospy.exceptions.ROSInitException as error:
        if rospy.core.is_shutdown_requested():
            sys.exit(1)  # interrupted before it began
        raise RigError(f"{error}.") from error
    except TypeError as error:  # yaml makes a date of 2001-01-01, which the parameter server cannot hold
        fault = f"A private parameter on the command line is no text, number or flag: {error}."
        raise RigError(f"{fault} Quote a date, as _name:=\"'2001-01-01'\".") from error
    prepare_log()


def prepare_process(disposable: bool) -> None:
    """Changes what a process has one of: heap, signals, the reports of threads; for a node that is `disposable`."""
    _close_watches_with_topics()
    open_closed_streams()
    sys.stdout.reconfigure(errors=UNPRINTABLE)
    # Each connection has threads, and each thread would keep a heap of its own, of images too: 20 visits of a listener
    # made 190 MiB of a node with 60, with one heap 115 MiB, of which no visit makes more.
    ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    _shut_down_beside_the_main_thread(disposable)
    end_closed_servers()
    hide_closed_connections()


def prepare_log() -> None:
    """Lets a log not wait for the master, not repeat itself, and not end what logs."""
    _log_without_the_master()
    logging.getLogger("rosout").addFilter(RepeatedExceptions())
    _log_as_far_as_possible()


def leave_after_all_threads(code: int) -> None:
    """Exits without destroying objects, once all threads but the daemons have ended."""
    for thread in threading.enumerate():  # one of them may shut ROS down
        if thread is not clock.current_thread() and not thread.daemon:
            thread.join()
    _leave(code)


def run_program(
    name: str, main: Callable[[], int | None], interrupted: str, errors: tuple[type[Exception], ...] = (RigError,)
) -> None:
    """Runs `main` of a program that a person starts, and exits the process. The exit code is that of `main`, 0 for
    None; 1 after one of the `errors`, whose sentences go to stderr; 130 after Ctrl-C or SIGTERM, which print
    `interrupted`."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    end_closed_servers()
    hide_closed_connections()
    open_closed_streams()
    sys.stdout.reconfigure(line_buffering=True, errors=UNPRINTABLE)
    try:
        check_folder()
        code = main() or 0
    except (RigError, *errors) as error:
        _report(name, error)
        code = 1
    except OSError:
        fault = lost_output()
        if not fault:
            raise
        _report(name, RigError(fault))
        code = 1
    except KeyboardInterrupt:
        print(f"\n{interrupted}")
        code = INTERRUPTED
    rospy.signal_shutdown("the program exits")
    sys.exit(code)


def open_closed_streams() -> None:
    """Lets a process whose output was closed, as by >&-, write to nobody instead of ending with a traceback."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  # for as long as the process


def lost_output() -> str:
    """Returns why nothing can be printed any more, a sentence; empty if a line end can."""
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError as error:
        with open(os.devnull, "w") as nobody:
            os.dup2(nobody.fileno(), sys.stdout.fileno())
        return f"The output cannot be written: {error.strerror}."
    return ""


def need_home(name: str) -> None:
    """Ends a program whose user has no home with a sentence; for one that imports matplotlib, which asks for it."""
    try:
        home()
    except RigError as error:
        sys.exit(f"{name}: {error}")


def check_folder() -> None:
    """Raises RigError if the current folder is gone, where each relative path would raise an error without a name."""
    try:
        os.getcwd()
    except FileNotFoundError as error:
        raise RigError("The current folder was deleted: cd to another one.") from error


def _close_watches_with_topics() -> None:
    """Makes a topic that is closed close the file that watches its connections. Rospy leaves it to Python's collector:
    a node that subscribes on demand a hundred times an hour, or a camera that restarts, had ever more open files."""
    close = rospy.topics._TopicImpl.close

    def close_with_watch(topic) -> None:
        close(topic)
        topic.connection_poll.poller.close()

    rospy.topics._TopicImpl.close = close_with_watch


class RepeatedExceptions(logging.Filter):
    """Passes an exception of a callback once in REPEAT_S; rospy logs its traceback with each message that raises it."""

    def __init__(self, now: Callable[[], float] | None = None) -> None:
        super().__init__()
        self._now = now or clock.monotonic
        self._logged: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        text = str(record.msg)
        if not text.startswith("bad callback: "):
            return True
        now, reason = self._now(), text.splitlines()[-1]
        if now - self._logged.get(reason, -REPEAT_S) < REPEAT_S:
            return False
        self._logged[reason] = now
        return True


def _log_without_the_master() -> None:
    """Looks up once whether messages of the log name the node's topics; rospy asks the master with each message. Then a
    node hangs where it logs while its master hangs. And the question also registers the node: one that logs after a
    newer node of its name has begun has the master end the newer one."""
    get_param_server_cache().set(LOG_TOPICS, bool(rospy.get_param(LOG_TOPICS, False)))


def _log_as_far_as_possible() -> None:
    """Lets no log end what logs: on a full disk, or where the reader is gone, rospy's handlers raise an OSError."""
    logging.raiseExceptions = False  # else logging reports the error to the same full disk
    for name in (None, "rosout"):
        for handler in logging.getLogger(name).handlers:
            handler.emit = _without_os_errors(handler.emit)  # type: ignore[method-assign]


def _without_os_errors(emit: Callable[[logging.LogRecord], None]) -> Callable[[logging.LogRecord], None]:
    def guarded(record: logging.LogRecord) -> None:
        with contextlib.suppress(OSError):
            emit(record)

    return guarded


def end_closed_servers() -> None:
    """Ends the thread of a node's XML-RPC server when rospy closes it at shutdown. It would ask the closed socket again
    and again (https://github.com/ros/ros_comm/issues/2238), and take a processor and Python's lock from what the node
    still does, such as braking an arm."""
    rosgraph.xmlrpc.ThreadingXMLRPCServer.service_actions = _end_if_closed


def _end_if_closed(server: rosgraph.xmlrpc.ThreadingXMLRPCServer) -> None:
    """Called by the server after each request, twice a second, and again and again once its socket is closed."""
    if server.fileno() < 0:
        raise ConnectionAbortedError("the server is closed")  # rosgraph expects one when it has closed the server


def hide_closed_connections() -> None:
    """Prints no traceback of a thread that rospy ends at shutdown by closing its socket or its topic."""
    report = threading.excepthook

    def reported(thread: threading.ExceptHookArgs) -> None:
        error = thread.exc_value
        socket_closed = isinstance(error, OSError) and error.errno == errno.EBADF
        topic_closed = isinstance(error, rospy.ROSException)  # as in actionlib's timer
        if not ((socket_closed or topic_closed) and rospy.core.is_shutdown_requested()):
            report(thread)

    threading.excepthook = reported


def _report(name: str, error: Exception) -> None:
    for sentence in _sentences(error):
        print(f"{name}: {sentence}", file=sys.stderr)


def _sentences(error: Exception) -> list[str]:
    return error.faults if isinstance(error, ConfigError) else [str(error)]


def _code_of(main: Callable[[], None]) -> int:
    try:
        _wait_for_clock()
        main()
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():  # then the topics close while main runs
            raise
    except RigError as error:
        for sentence in _sentences(error):
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
    clock_s = 8.0  # a node that starts is to exit within 10 s
    clock_poll_s = 0.05
    deadline = clock.monotonic() + clock_s
    while not rospy.rostime.is_wallclock() and rospy.get_rostime().is_zero():
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shut down while waiting for /clock")
        if clock.monotonic() > deadline:
            raise RigError(
                f"The parameter use_sim_time is true, but nobody publishes /clock within {clock_s:g} s: play a "
                "recording with --clock, or rosparam set use_sim_time false."
            )
        clock.sleep(clock_poll_s)


def _shut_down_beside_the_main_thread(leave: bool) -> None:
    """Takes SIGINT and SIGTERM out of rospy's hands, whose handler closes the topics in the main thread: if that thread
    is publishing or asks the master, it holds the lock that the handler waits for, and the node hangs. With `leave` the
    process exits afterwards. After END_S it prints where its threads are, and exits with 1. The kernel may give a
    signal to any thread, and a main thread that waits for a lock would not learn of it. So it comes through a socket
    (signal.set_wakeup_fd)."""
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    numbers = (signal.SIGINT, signal.SIGTERM)

    def shut_down(reason: str) -> None:
        rospy.signal_shutdown(reason)
        if leave:
            _leave(0)

    def listen() -> None:
        with reader, writer:
            while (number := reader.recv(1)[0]) not in numbers:
                pass
            faulthandler.dump_traceback_later(END_S, exit=True)
            clock.Thread(target=shut_down, args=(f"signal-{number}",), name="shutdown").start()
            clock.Event().wait()  # the socket stays open for the signals that follow

    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    for number in numbers:
        signal.signal(number, lambda *_: None)
    clock.Thread(target=listen, name="signals", daemon=True).start()


def run_together(*jobs: Callable[[], None]) -> None:
    """Runs each job in a thread of its own until all have returned; if one raises, the reason goes to the log, ROS
    shuts down, which ends the others, and the exception is raised here."""
    ended: clock.Queue[BaseException | None] = clock.Queue()

    def run(job: Callable[[], None]) -> None:
        failure = None
        try:
            job()
        except BaseException as error:
            failure = error
        ended.put(failure)

    threads = [clock.Thread(target=run, args=(job,), name="job") for job in jobs]
    try:
        for thread in threads:
            thread.start()
        for _ in threads:
            failure = ended.get()
            if failure is not None:
                raise failure
    except Exception as error:
        if not rospy.core.is_shutdown_requested():
            rospy.logfatal("A part of this node has failed, so all end: %s: %s", type(error).__name__, error)
        raise
    finally:
        rospy.signal_shutdown("a job of the node has ended")
        for thread in threads:
            if thread.ident is not None:  # else it could not be started
                thread.join()


def dispensable(job: Callable[[], None]) -> None:
    """Runs a job of `run_together` that the others can do without: a DeviceError goes to the log and ends only it."""
    try:
        job()
    except DeviceError as error:
        rospy.logfatal("%s: %s The other parts of this node continue.", rospy.get_name(), error)


@contextlib.contextmanager
def while_running() -> Iterator[None]:
    """For callbacks: ignores that a topic is closed because ROS shuts down."""
    try:
        yield
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():  # which is true as soon as the topics close, is_shutdown() later
            raise


def repeat(job: Callable[[], None], period: float, name: str) -> None:
    """Calls `job` every `period` [s] in a thread of its own, until ROS shuts down. rospy.Timer prints a traceback where
    it sleeps between the request to shut down and the end."""
    stop = clock.Event()
    rospy.on_shutdown(stop.set)

    def loop() -> None:
        while not stop.wait(period):
            with while_running():
                job()

    clock.Thread(target=loop, name=name, daemon=True).start()

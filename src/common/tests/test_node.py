"""The life of a node: how it ends when it is interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import xmlrpc.client

import pytest

pytestmark = pytest.mark.ros


@pytest.fixture
def start(processes, tmp_path):
    """Starts a program, given its text."""

    def run(text):
        file = tmp_path / "program.py"
        file.write_text(text)
        return processes.start(sys.executable, str(file))

    return run


PUBLISHING = """
import os, signal, sys
import rospy
from std_msgs.msg import String
from common.ros.node import run

class InterruptedQueue(list):
    def append(self, item):  # called while the lock of the queue is held
        super().append(item)
        os.kill(os.getpid(), {signal})

def main():
    publisher = rospy.Publisher("chatter", String, queue_size=10)
    while publisher.get_num_connections() == 0:
        rospy.sleep(0.01)
    for connection in publisher.impl.connections:
        connection._queue = InterruptedQueue()
    while not rospy.is_shutdown():
        publisher.publish("again")

run("talker", main)
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_node_that_is_interrupted_while_it_publishes_ends(ros, start, wait_until, name):
    from std_msgs.msg import String

    ros.record("chatter", String)
    process = start(PUBLISHING.format(signal=int(getattr(signal, name))))
    wait_until(lambda: process.poll() is not None, 20.0, "the end of the node")
    log = process.log_path.read_text()
    assert process.returncode == 0 and "Traceback" not in log, log


STARTING = """
import os, threading
import rospy
from rospy.core import _LockedServerProxy
from common.ros.node import run

request = _LockedServerProxy._ServerProxy__request

def interrupted_request(proxy, method, parameters):
    if method == "{method}" and threading.current_thread() is threading.main_thread():
        with proxy._lock:  # as while it waits for the master's answer
            os.kill(os.getpid(), {signal})
    return request(proxy, method, parameters)

_LockedServerProxy._ServerProxy__request = interrupted_request
run("starter", rospy.spin)
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("method", ["getParam", "registerService"])
def test_a_node_that_is_interrupted_while_it_starts_ends(ros, start, wait_until, name, method):
    number = int(getattr(signal, name))
    process = start(STARTING.format(signal=number, method=method))
    wait_until(lambda: process.poll() is not None, 20.0, "the end of the node")
    log = process.log_path.read_text()
    assert process.returncode in (0, 1) and "Traceback" not in log, log


THREADS = """
import socket, threading
import rospy
from common.ros.node import run

def main():
    for error in (OSError(9, "early socket"), rospy.ROSException("early topic"), ValueError("other")):
        raises(error)
    rospy.core.signal_shutdown("the end")
    for error in (OSError(9, "late"), rospy.ROSException("late"), OSError(28, "full"), ValueError("defect")):
        raises(error)

def raises(error):
    def job():
        raise error
    thread = threading.Thread(target=job)
    thread.start()
    thread.join()

run("threads", main)
"""


def test_only_a_socket_or_topic_that_is_closed_at_the_end_ends_its_thread_in_silence(ros, start, wait_until):
    process = start(THREADS)
    wait_until(lambda: process.poll() is not None, 20.0, "the end of the node")
    log = process.log_path.read_text()
    said = ("early socket", "early topic", "other", "full", "defect")
    assert "late" not in log and all(word in log for word in said), log


ANY_THREAD = """
import signal, threading, time
import rospy
from common.ros.node import run, run_together

def job():
    while not rospy.is_shutdown():
        time.sleep(0.05)

def interrupt():
    (thread,) = (thread for thread in threading.enumerate() if thread.name == "job")
    signal.pthread_kill(thread.ident, signal.SIGINT)

def main():
    threading.Timer(1.0, interrupt).start()
    run_together(job)

run("together", main)
"""


def test_an_interrupt_that_reaches_another_thread_ends_the_node(ros, start, wait_until):
    process = start(ANY_THREAD)
    wait_until(lambda: process.poll() is not None, 10.0, "the end of the node")
    assert process.returncode == 0 and "Traceback" not in process.log_path.read_text()


TOPICS = """
import gc, os, time
import rospy
from std_msgs.msg import String
from common.ros.node import run

def watches():
    files = [f"/proc/self/fd/{name}" for name in os.listdir("/proc/self/fd")]
    return sum(os.path.lexists(file) and "eventpoll" in os.readlink(file) for file in files)

def main():
    gc.disable()
    before = watches()
    chatter, listener = publisher("chatter"), subscriber("images")
    for _ in range(20):
        opened_and_closed(subscriber, "chatter")
        opened_and_closed(publisher, "images")
        wait(lambda: not listener.get_num_connections())  # or rospy takes the next publisher for this one
    wait(lambda: watches() - before <= 4)  # connections that are just ending
    print(f"left: {watches() - before}")

def opened_and_closed(make, name):
    topic = make(name)
    wait(topic.get_num_connections)
    topic.unregister()

def wait(condition):
    end = time.monotonic() + 30.0
    while not condition() and time.monotonic() < end:
        rospy.sleep(0.01)

def publisher(name):
    return rospy.Publisher(name, String, queue_size=1)

def subscriber(name):
    return rospy.Subscriber(name, String, lambda message: None)

run("listener", main)
"""


def test_a_topic_that_is_closed_leaves_no_open_file(ros, start, wait_until):
    process = start(TOPICS)
    wait_until(lambda: process.poll() is not None, 40.0, "the end of the node")
    log = process.log_path.read_text()
    left = int(log.partition("left: ")[2].split()[0])
    assert left <= 4, log  # the two that stay, and those whose connections are just ending


SERVER = """
import sys, time, traceback
import rospy
from common.ros.node import run, run_program

def serves():
    stacks = [traceback.walk_stack(frame) for frame in sys._current_frames().values()]
    return any(frame.f_code.co_name == "serve_forever" for stack in stacks for frame, _ in stack)

def main():
    assert serves()
    rospy.signal_shutdown("the node ends, and has still to do")
    until = time.monotonic() + 20.0
    while serves() and time.monotonic() < until:
        time.sleep(0.05)
    print("serves:", serves())

def program():
    rospy.init_node("worker", disable_signals=True)
    main()

{start}
"""


@pytest.mark.parametrize("how", ['run("worker", main)', 'run_program("worker", program, "")'])
def test_the_server_of_a_node_ends_with_it(ros, start, wait_until, how):
    """Else its thread takes a processor, and Python's lock, from what the node does at its end."""
    process = start(SERVER.format(start=how))
    wait_until(lambda: process.poll() is not None, 40.0, "the end of the node")
    assert "serves: False" in process.log_path.read_text()


HEAPS = """
import ctypes, threading
from common.ros.node import run

def main():
    together = threading.Barrier(8)

    def work():
        kept = [bytearray(1000) for _ in range(100)]
        together.wait()
        del kept

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    libc = ctypes.CDLL(None)
    libc.fopen.restype, libc.fclose.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
    libc.malloc_info.argtypes = [ctypes.c_int, ctypes.c_void_p]
    file = libc.fopen(b"{path}", b"w")
    libc.malloc_info(0, file)
    libc.fclose(file)

run("worker", main)
"""


def test_the_threads_of_a_node_share_one_heap(ros, start, wait_until, tmp_path):
    found = tmp_path / "heaps.xml"
    process = start(HEAPS.format(path=found))
    wait_until(lambda: process.poll() is not None, 40.0, "the end of the node")
    assert found.read_text().count("<heap nr=") == 1, process.log_path.read_text()


DISPOSABLE = """
import atexit, sys, threading
import rospy
from common.errors import RigError
from common.ros.node import run

def main():
    atexit.register(threading.Event().wait)  # an interpreter that is taken apart never ends
    rospy.on_shutdown(lambda: print("saved"))
    print("works")
    {work}

run("worker", main, disposable=True)
"""


def start_disposable(processes, work):
    # Without PYTHONUNBUFFERED, as users run it: what was printed must not be lost.
    return processes.start(sys.executable, "-c", DISPOSABLE.format(work=work), env={"PYTHONUNBUFFERED": ""})


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_disposable_node_ends_wherever_it_is(ros, processes, wait_until, name):
    busy = "rospy.set_param('busy', True)\n    while True: sum(range(10000))"
    process = start_disposable(processes, busy)
    wait_until(lambda: ros_has("/busy"), 20.0, "work")
    process.send_signal(getattr(signal, name))
    process.send_signal(signal.SIGINT)
    wait_until(lambda: process.poll() is not None, 20.0, "the end of the node")
    assert (process.returncode, process.log_path.read_text()) == (0, "works\nsaved\n")


@pytest.mark.parametrize(
    ("work", "code", "said"),
    [
        ("pass", 0, ""),
        ("rospy.signal_shutdown('enough'); rospy.spin()", 0, ""),
        ("raise RigError('There is no rig.')", 1, "/worker: There is no rig.\n"),
    ],
)
def test_a_disposable_node_that_has_done_its_work_ends(ros, processes, wait_until, work, code, said):
    process = start_disposable(processes, work)
    wait_until(lambda: process.poll() is not None, 20.0, "the end of the node")
    log = process.log_path.read_text()
    assert process.returncode == code, log
    assert "works\n" in log and "saved\n" in log and said in log and "Traceback" not in log


def ros_has(name):
    import rospy

    return rospy.has_param(name)


def test_the_exception_of_a_callback_is_logged_once_in_a_while_and_all_else_always():
    import logging

    from common.ros.node import REPEAT_S, RepeatedExceptions

    now = 100.0
    repeated = RepeatedExceptions(lambda: now)

    def passes(text):
        return repeated.filter(logging.LogRecord("rosout", logging.ERROR, "", 0, text, (), None))

    bad = "bad callback: <f>\nTraceback\nValueError: {}"
    assert passes(bad.format("a")) and passes(bad.format("b")) and passes("a sentence") and passes("a sentence")
    assert not passes(bad.format("a")) and not passes(bad.format("b"))
    now += REPEAT_S
    assert passes(bad.format("a")) and not passes(bad.format("a"))


LOGGING = """
import rospy
from common.ros.node import run

def main():
    for i in range(100):
        rospy.logerr("line %d of a log that no longer fits onto the disk", i)
    rospy.set_param("went_on", True)

run("talkative", main)
"""


def test_a_node_whose_log_the_full_disk_does_not_take_works_on(ros, processes, wait_until):
    """No file may grow beyond 2 kB."""
    process = processes.start("bash", "-c", 'ulimit -f 2; exec "$0" -c "$1"', sys.executable, LOGGING)
    wait_until(lambda: process.poll() is not None, 20.0, "the end of the node")
    assert process.returncode == 0 and ros_has("went_on"), process.log_path.read_text()


LEAVING = """
import rospy
from common.ros.node import run

def main():
    rospy.set_param("started", rospy.get_param("started", 0) + 1)
    while not rospy.core.is_shutdown_requested():
        rospy.sleep(0.01)
    rospy.loginfo("The node has ended.")

run("twin", main)
"""


def test_of_two_nodes_with_one_name_the_newer_one_stays(ros, start, wait_until):
    """What the older one logs at its end is no reason for the master to end the newer one."""
    import rospy

    twins = []
    for number in (1, 2):
        twins.append(start(LEAVING))
        wait_until(lambda number=number: rospy.get_param("/started", 0) == number, 20.0, "the node")
    older, newer = twins
    wait_until(lambda: older.poll() is not None, 20.0, "the end of the older one")
    assert older.returncode == 0 and "The node has ended." in older.log_path.read_text()
    with pytest.raises(subprocess.TimeoutExpired):
        newer.wait(0.5)


def test_a_node_logs_while_the_master_hangs(ros_master, processes, tmp_path, free_port, suspend, wait_until):
    """Else a controller would hang with it, in the midst of a motion."""
    uri = f"http://localhost:{free_port()}"
    core = processes.start("rosmaster", "--core", "-p", uri.rpartition(":")[2])
    master = xmlrpc.client.ServerProxy(uri)
    pid = wait_until(lambda: pid_of(master), 20.0, "the master")
    go_on = tmp_path / "go_on"
    logging = f"""
import os, time
import rospy
from common.ros.node import run

def main():
    print("started")
    while not os.path.exists({str(go_on)!r}):
        time.sleep(0.01)
    rospy.loginfo("a line")
    print("went on")

run("talkative", main)
"""
    node = processes.start(sys.executable, "-c", logging, env={"ROS_MASTER_URI": uri})
    wait_until(lambda: "started" in node.log_path.read_text(), 20.0, "the node")
    suspend(pid)
    try:
        go_on.touch()
        wait_until(lambda: "went on" in node.log_path.read_text(), 5.0, "what follows the line")
    finally:
        os.kill(pid, signal.SIGCONT)
    assert core.poll() is None


def pid_of(master):
    try:
        return master.getPid("/test")[2]
    except OSError:
        return None

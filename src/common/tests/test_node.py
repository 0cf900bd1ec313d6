"""The life of a node as a process: how it ends when it is interrupted, and what it does meanwhile."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import xmlrpc.client

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import logging

import rospy
from std_msgs.msg import String

from common.ros.node import REPEAT_S, RepeatedExceptions, run

pytestmark = pytest.mark.ros

END_S = 30.0
"""Longest wait for the end of a node."""


@pytest.fixture
def start(processes, tmp_path):
    """Starts a program, given its text, as a node of this name."""

    def run(name, text, **env):
        file = tmp_path / f"{name}.py"
        file.write_text(text)
        return processes.start(sys.executable, str(file), f"__name:={name}", env=env)

    return run


PUBLISHING = """
import os, signal
import rospy
from std_msgs.msg import String
from common.ros.node import run

class InterruptedQueue(list):
    def append(self, item):  # called while the lock of the queue is held
        super().append(item)
        os.kill(os.getpid(), signal.{signal})

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
STARTING = """
import os, signal, threading
import rospy
from rospy.core import _LockedServerProxy
from common.ros.node import run

request = _LockedServerProxy._ServerProxy__request

def interrupted_request(proxy, method, parameters):
    if method == "{method}" and threading.current_thread() is threading.main_thread():
        with proxy._lock:  # as while it waits for the master's answer
            os.kill(os.getpid(), signal.{signal})
    return request(proxy, method, parameters)

_LockedServerProxy._ServerProxy__request = interrupted_request
run("starter", rospy.spin)
"""
ASKED = ("getParam", "registerService")
ANY_THREAD = """
import signal, threading, time
import rospy
from common.ros.node import run, run_together

def job():
    signal.pthread_kill(threading.get_ident(), signal.{signal})
    while not rospy.is_shutdown():
        time.sleep(0.05)

run("together", lambda: run_together(job))
"""


@pytest.mark.real
def test_a_node_ends_wherever_a_signal_reaches_it(ros, start):
    """While it publishes, while it asks the master, and in another thread than the main one."""
    ros.record("chatter", String)
    places = {"publishing": PUBLISHING, "thread": ANY_THREAD}
    places.update((method, STARTING.replace("{method}", method)) for method in ASKED)
    started = {}
    for number in ("SIGINT", "SIGTERM"):
        for place, text in places.items():
            started[place, number] = start(f"{place}_{number}", text.replace("{signal}", number))
    for (place, number), process in started.items():
        code, log = process.wait(END_S), process.log_path.read_text()
        assert code == 0 or (code == 1 and place in ASKED), (place, number, log)
        assert "Traceback" not in log, (place, number, log)


LIFE = """
import ctypes, gc, json, os, socket, sys, threading, time, traceback
import rospy
from std_msgs.msg import String
from common.ros.node import run, run_program

found = {{}}

def main():
    for error in (OSError(9, "early socket"), rospy.ROSException("early topic"), ValueError("other")):
        raises(error)
    if rospy.get_name() == "/node":
        found["heaps"], found["left open"] = heaps(), left_open()
    found["served"] = serves()
    rospy.signal_shutdown("the node ends, and has still to do")
    wait(lambda: not serves())
    found["serves"] = serves()
    for error in (OSError(9, "late"), rospy.ROSException("late"), OSError(28, "full"), ValueError("defect")):
        raises(error)
    print(json.dumps(found))

def raises(error):
    def job():
        raise error
    thread = threading.Thread(target=job)
    thread.start()
    thread.join()

def heaps():
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
    libc, path = ctypes.CDLL(None), f"{folder}/{{os.getpid()}}.xml"
    libc.fopen.restype, libc.fclose.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
    libc.malloc_info.argtypes = [ctypes.c_int, ctypes.c_void_p]
    file = libc.fopen(path.encode(), b"w")
    libc.malloc_info(0, file)
    libc.fclose(file)
    return open(path).read().count("<heap nr=")

def left_open():
    gc.disable()
    before = watches()
    chatter, listener = publisher("~chatter"), subscriber("~images")
    for _ in range(20):
        opened_and_closed(subscriber, "~chatter")
        opened_and_closed(publisher, "~images")
        wait(lambda: not listener.get_num_connections())  # or rospy takes the next publisher for this one
    wait(lambda: watches() - before <= 4)  # connections that are just ending
    return watches() - before

def watches():
    files = [f"/proc/self/fd/{{name}}" for name in os.listdir("/proc/self/fd")]
    return sum(os.path.lexists(file) and "eventpoll" in os.readlink(file) for file in files)

def opened_and_closed(make, name):
    topic = make(name)
    wait(topic.get_num_connections)
    topic.unregister()

def publisher(name):
    return rospy.Publisher(name, String, queue_size=1)

def subscriber(name):
    return rospy.Subscriber(name, String, lambda message: None)

def serves():
    stacks = [traceback.walk_stack(frame) for frame in sys._current_frames().values()]
    return any(frame.f_code.co_name == "serve_forever" for stack in stacks for frame, _ in stack)

def wait(condition):
    end = time.monotonic() + 60.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)

def program():
    rospy.init_node("worker", disable_signals=True)
    main()

{start}
"""


@pytest.mark.real
def test_what_is_closed_is_silent_and_leaves_nothing_and_threads_share_one_heap(start, ros, tmp_path):
    """Only a thread whose socket or topic is closed at the end ends in silence. A node's server that went on would take
    a processor, and Python's lock, from what the node does at its end.
    """
    ways = {"node": 'run("worker", main)', "program": 'run_program("worker", program, "")'}
    started = {name: start(name, LIFE.format(start=how, folder=tmp_path)) for name, how in ways.items()}
    for name, process in started.items():
        code, log = process.wait(END_S), process.log_path.read_text()
        assert code == 0, log
        said = ("early socket", "early topic", "other", "full", "defect")
        assert "late" not in log and all(word in log for word in said), log
        found = json.loads(log.splitlines()[-1])
        assert (found["served"], found["serves"]) == (True, False), (name, found)
        if name == "node":
            # Open are the two that stay, and those whose connections are just ending.
            assert found["heaps"] == 1 and found["left open"] <= 4, found


HANGS = """
import threading
import rospy
import common.ros.node as node

def main():
    rospy.set_param("~begun", True)
    threading.Event().wait()

node.END_S = 1.0
node.run("worker", main)
"""


@pytest.mark.real
def test_a_node_that_does_not_end_says_where_it_is(ros, start, wait_until):
    process = start("hangs", HANGS)
    wait_until(lambda: ros_has("/hangs/begun"), END_S, "the node")
    process.send_signal(signal.SIGINT)
    code, log = process.wait(END_S), process.log_path.read_text()
    assert code == 1 and re.search(r'hangs.py", line \d+ in main', log), log


DISPOSABLE = """
import atexit, threading
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


@pytest.mark.real
def test_a_disposable_node_ends_wherever_it_is_and_when_it_has_done_its_work(ros, start, wait_until):
    busy = "rospy.set_param('~busy', True)\n    while True: sum(range(10000))"
    works = {
        "SIGINT": (busy, 0, ""), "SIGTERM": (busy, 0, ""), "passes": ("pass", 0, ""),
        "shuts_down": ("rospy.signal_shutdown('enough'); rospy.spin()", 0, ""),
        "fails": ("raise RigError('There is no rig.')", 1, "/fails: There is no rig.\n"),
    }  # fmt: skip
    # Without PYTHONUNBUFFERED, as users run it: what was printed must not be lost.
    started = {n: start(n, DISPOSABLE.format(work=work), PYTHONUNBUFFERED="") for n, (work, _, _) in works.items()}
    for name in ("SIGINT", "SIGTERM"):
        wait_until(lambda name=name: ros_has(f"/{name}/busy"), END_S, "work")
        started[name].send_signal(getattr(signal, name))
        started[name].send_signal(signal.SIGINT)
    for name, process in started.items():
        _, code, said = works[name]
        assert process.wait(END_S) == code, (name, process.log_path.read_text())
        log = process.log_path.read_text()
        assert "works\n" in log and "saved\n" in log and said in log and "Traceback" not in log, log
        assert name not in ("SIGINT", "SIGTERM") or log == "works\nsaved\n"


def ros_has(name):
    return rospy.has_param(name)


def test_the_exception_of_a_callback_is_logged_once_in_a_while_and_all_else_always():
    now = 100.0
    repeated = RepeatedExceptions(lambda: now)

    def passes(text):
        return repeated.filter(logging.LogRecord("rosout", logging.ERROR, "", 0, text, (), None))

    bad = "bad callback: <f>\nTraceback\nValueError: {}"
    assert passes(bad.format("a")) and passes(bad.format("b")) and passes("a sentence") and passes("a sentence")
    assert not passes(bad.format("a")) and not passes(bad.format("b"))
    now += REPEAT_S
    assert passes(bad.format("a")) and not passes(bad.format("a"))


def test_simulated_time_without_a_clock_is_said(virtual_graph):
    rospy.set_param("use_sim_time", True)
    begun = clock.monotonic()
    node = virtual_graph.start("timeless", lambda: run("timeless", lambda: None))
    assert node.wait(20.0) == 1 and clock.monotonic() - begun == pytest.approx(8.0, abs=0.1)
    assert "use_sim_time is true, but nobody publishes /clock within 8 s" in node.log and "Traceback" not in node.log


LOGGING = """
import rospy
from common.ros.node import run

def main():
    for i in range(100):
        rospy.logerr("line %d of a log that no longer fits onto the disk", i)
    rospy.set_param("went_on", True)

run("talkative", main)
"""
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


@pytest.mark.real
def test_a_log_ends_no_node(ros, start, processes, wait_until):
    """Neither on a full disk: no file may grow beyond 2 kB. Nor what an older node of the same name logs at its end: it
    is no reason for the master to end the newer one.

    Reported in https://github.com/ros/ros_comm/issues/2018: of two nodes with one name both end. Tried: a node
    started twice.
    """
    talkative = processes.start("bash", "-c", 'ulimit -f 2; exec "$0" -c "$1"', sys.executable, LOGGING)
    twins = []
    for number in (1, 2):
        twins.append(start("twin", LEAVING))
        wait_until(lambda number=number: rospy.get_param("/started", 0) == number, END_S, "the node")
    codes = [twins[0].wait(END_S)]
    twins[1].send_signal(signal.SIGINT)
    codes.append(twins[1].wait(END_S))
    older, newer = (twin.log_path.read_text() for twin in twins)
    assert codes == [0, 0] and all("The node has ended." in log for log in (older, newer))
    assert "new node registered with same name" in older and "new node registered" not in newer
    assert talkative.wait(END_S) == 0 and ros_has("went_on"), talkative.log_path.read_text()


@pytest.mark.real
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


PROGRAM = """
from common.ros.node import run_program
run_program("it", lambda: [print(i) for i in range(9)] and 0, "end")
"""


@pytest.mark.real
@pytest.mark.parametrize(
    ("output", "code", "said"),
    [(">/dev/full", 1, "it: The output cannot be written: No space left on device.\n"), (">&-", 0, "")],
)
def test_a_program_whose_output_goes_nowhere_has_no_traceback(output, code, said):
    command = ["bash", "-c", f'exec "$0" -c "$1" {output}', sys.executable, PROGRAM]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, said)

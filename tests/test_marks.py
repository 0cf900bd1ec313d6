"""Which tests are real: no other opens a socket, starts a program or sleeps, and each file names its marks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.real

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def ran(tmp_path):
    """Runs the text of a file of tests with the project's conftest.py; returns the exit code and what was printed."""

    def run(text):
        file = tmp_path / f"test_{len([*tmp_path.glob('test_*.py')])}.py"  # a name of its own: nothing is cached of it
        file.write_text(text)
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        settings = ["-p", "conftest", "-c", ROOT / "pyproject.toml", f"--rootdir={ROOT}"]
        command = [sys.executable, "-m", "pytest", "-q", *settings, file]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    return run


@pytest.mark.parametrize("mark", ["ros", "real", "long"])
def test_a_file_that_does_not_name_its_mark_is_refused(ran, mark):
    code, said = ran(f"pytestmark = getattr(__import__('pytest').mark, '{mark}')\ndef test_hidden():\n    pass\n")
    assert code == pytest.ExitCode.USAGE_ERROR and "test_hidden" in said and repr(mark) in said


LEAVE = """
import multiprocessing, os, queue, select, socket, subprocess, threading, time
import pytest
from common import clock

@pytest.fixture
def before():
    os.system("true")

@pytest.fixture
def after():
    yield
    os.system("true")

def test_bind(): socket.socket().bind(("127.0.0.1", 0))
def test_popen(): subprocess.run(["true"])
def test_before(before): pass
def test_after(after): pass
def test_spawn(): os.posix_spawn("/bin/true", ["true"], {})
def test_sleep(): time.sleep(0.001)
def test_clock(): clock.sleep(0.001)
def test_message(): socket.socket(type=socket.SOCK_DGRAM).sendmsg([b""], [], 0, ("127.0.0.1", 9))
def test_select(): select.select([], [], [], 0.001)
def test_event(): threading.Event().wait(0.001)
def test_condition():
    with (condition := threading.Condition()): condition.wait(timeout=0.001)
def test_queue():
    with pytest.raises(queue.Empty): queue.Queue().get(timeout=0.001)
def test_multiprocessing():
    process = multiprocessing.get_context("spawn").Process(target=print)
    process.start(), process.join()
"""


def test_a_test_that_leaves_its_process_must_be_marked(ran):
    code, said = ran(LEAVE)
    assert code == pytest.ExitCode.TESTS_FAILED
    events = {"bind": "socket.bind", "popen": "subprocess.Popen", "before": "os.system", "after": "os.system"}
    events.update({"spawn": "os.posix_spawn", "sleep": "time.sleep", "clock": "time.sleep"})
    events.update({"message": "socket.sendmsg", "select": "select.select", "condition": "Condition.wait"})
    events.update({"event": "Condition.wait, Event.wait", "queue": "Condition.wait, Queue.get"})
    events.update({"multiprocessing": "multiprocessing.util.spawnv_passfds"})
    failed = dict(re.findall(r"ERROR at teardown of test_(\w+) _+\n.*\[(.*)\]", said.replace("'", "")))
    assert failed == events, said
    for mark in ("real", "long"):
        assert ran(f"{LEAVE}pytestmark = pytest.mark.{mark}\n")[0] == pytest.ExitCode.OK


def test_who_only_gives_way_or_sleeps_in_virtual_time_needs_no_mark(ran):
    code, said = ran(
        "import threading, time\nfrom common import clock\nfrom simulated.clock import virtual_time\n"
        "def test_a():\n    time.sleep(0), threading.Event().wait(0)\n"
        "    with virtual_time():\n        clock.sleep(1.0)\n"
    )
    assert code == pytest.ExitCode.OK, said


def test_what_another_test_did_is_not_its_own(ran):
    shared = "import os, pytest\n@pytest.fixture(scope='session')\ndef shared():\n    yield\n    os.system('true')\n"
    pure = "def test_pure():\n    pass\n"
    code, said = ran(f"{shared}@pytest.mark.real\ndef test_a(shared):\n    os.system('true')\n{pure}")
    assert code == pytest.ExitCode.OK, said

"""The process that the Emergency Stop may end: the controller's, and no other that got its number."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace

import pytest

pytest.importorskip("rospy")
from kuka_control.ros import emergency as controllers

SLEEP = "import time; print('ready', flush=True); time.sleep(60)"


@pytest.mark.real
def test_a_controller_is_found_and_ended_and_no_other_process(tmp_path, processes, wait_until, suspend):
    def start(name):
        program = tmp_path / name
        program.write_text(SLEEP)
        return processes.start(sys.executable, str(program))

    names = ("real_time_controller.py", "a (name) with controller.py", "ended controller.py", "leapd.py")
    started = [start(name) for name in names]
    for process in started:
        wait_until(lambda log=process.log_path: "ready" in log.read_text(), 20.0, "the program")
    running, stopped, ended, other = started
    suspend(stopped.pid)
    gone = controllers.find(ended.pid)
    os.kill(ended.pid, signal.SIGKILL)
    wait_until(lambda: not controllers.runs(gone), 10.0, "the end of a process whose parent has not looked")
    assert os.path.exists(f"/proc/{ended.pid}")
    assert controllers.find(ended.pid) is None and controllers.find(other.pid) is None

    earlier = replace(controllers.find(running.pid), start=1)  # had the number at another time
    assert not controllers.runs(earlier)
    controllers.kill(earlier)
    assert running.poll() is None

    for process in (running, stopped):
        found = controllers.find(process.pid)
        assert found.pid == process.pid and controllers.runs(found)
        controllers.kill(found)
        assert process.wait(10.0) == -signal.SIGKILL
        assert not controllers.runs(found) and controllers.find(process.pid) is None
        controllers.kill(found)


@pytest.mark.parametrize("pid", [0, -1, 2**30])
def test_a_number_without_a_process_is_nobody(pid):
    assert controllers.find(pid) is None

"""The process that the Emergency Stop may end: the controller's, and no other that got its number."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace

import pytest

pytest.importorskip("rospy")
from kuka_control.ros import emergency as processes_of_controllers

SLEEP = "import time; print('ready', flush=True); time.sleep(60)"


@pytest.fixture
def start(tmp_path, processes, wait_until):
    """Starts a Python program of the given file name that sleeps."""

    def start_program(name="real_time_controller.py"):
        program = tmp_path / name
        program.write_text(SLEEP)
        process = processes.start(sys.executable, str(program))
        wait_until(lambda: "ready" in process.log_path.read_text(), 20.0, "the program")
        return process

    return start_program


def test_a_controller_is_found_and_ended(start):
    process = start()
    found = processes_of_controllers.find(process.pid)
    assert found.pid == process.pid and processes_of_controllers.runs(found)
    processes_of_controllers.kill(found)
    assert process.wait(10.0) == -signal.SIGKILL
    assert not processes_of_controllers.runs(found) and processes_of_controllers.find(process.pid) is None
    processes_of_controllers.kill(found)


def test_a_stopped_controller_runs_and_is_ended(start, suspend):
    process = start("a (name) with controller.py")
    suspend(process.pid)
    found = processes_of_controllers.find(process.pid)
    assert processes_of_controllers.runs(found)
    processes_of_controllers.kill(found)
    assert process.wait(10.0) == -signal.SIGKILL


def test_an_ended_process_whose_parent_has_not_looked_has_ended(start, wait_until):
    process = start()
    found = processes_of_controllers.find(process.pid)
    os.kill(process.pid, signal.SIGKILL)
    wait_until(lambda: not processes_of_controllers.runs(found), 10.0, "the end of the process")
    assert os.path.exists(f"/proc/{process.pid}")
    assert processes_of_controllers.find(process.pid) is None


def test_the_same_number_at_another_time_is_another_process(start):
    process = start()
    earlier = replace(processes_of_controllers.find(process.pid), start=1)
    assert not processes_of_controllers.runs(earlier)
    processes_of_controllers.kill(earlier)
    assert process.poll() is None


@pytest.mark.parametrize("pid", [0, -1, 2**30])
def test_a_number_without_a_process_is_nobody(pid):
    assert processes_of_controllers.find(pid) is None


def test_other_programs_are_never_found(start):
    assert processes_of_controllers.find(start("leapd.py").pid) is None

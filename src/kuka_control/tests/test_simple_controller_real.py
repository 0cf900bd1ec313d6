"""The simple controller as a program that a person starts at a terminal, beside a real simulated robot."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from controller_rig import MOVE_S, run_robot

pytestmark = [pytest.mark.ros, pytest.mark.real]

NEAR = [0, 5, 0, -10, 0, 5, 0]


@pytest.fixture
def robot(processes, wait_until, monkeypatch, free_port):
    """Starts the simulated robot, without a master."""
    monkeypatch.setenv("ROS_MASTER_URI", f"http://localhost:{free_port()}")
    programs = SimpleNamespace(run=lambda *command: processes.start("rosrun", *command))
    robot = run_robot(programs, wait_until, "--port", "0", "--control-port", "0")
    robot.here = ("--ip", "127.0.0.1", "--port", robot.port)
    return robot


class Person:
    """Somebody who runs the program at a terminal."""

    def __init__(self, *command):
        self._terminal, slave = pty.openpty()
        self.process = subprocess.Popen(
            [*map(str, command)],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
        )
        os.close(slave)
        self.seen = ""

    def types(self, text):
        os.write(self._terminal, text.encode())

    def interrupts(self):
        """Presses Ctrl-C, and again if nothing happens: Python misses one that comes just before it waits for input."""
        for _ in range(20):
            self.process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(3.0)
                return
            with contextlib.suppress(OSError):  # a terminal without a program
                while select.select([self._terminal], [], [], 0.0)[0]:
                    self.seen += os.read(self._terminal, 4096).decode()
            if "Nothing was moved." in self.seen:
                return  # it ends; another Ctrl-C would fall into that

    def reads_until(self, text):
        while text not in self.seen:
            data = os.read(self._terminal, 4096)
            assert data, self.seen
            self.seen += data.decode()

    def reads_to_the_end(self):
        with contextlib.suppress(OSError):  # so a terminal without a program ends
            while True:
                self.seen += os.read(self._terminal, 4096).decode()
        return self.process.wait(MOVE_S)

    def leaves(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(10.0)
        os.close(self._terminal)


@pytest.fixture
def person(without_search):
    """Starts the program for a person."""
    people = []
    program = without_search(("rosrun", "kuka_control", "simple_controller.py"))

    def sit_down(*arguments):
        people.append(Person(*program, *arguments))
        return people[-1]

    yield sit_down
    for one in people:
        one.leaves()


def test_it_asks_and_only_on_yes_it_moves_with_a_live_bar(robot, person):
    for answer, code in (("n\n", 1), ("\x04", 1), ("\x03", 130)):
        somebody = person(*NEAR, *robot.here)
        somebody.reads_until("Move the arm to the given angles? [y/N]")
        assert "Largest step" in somebody.seen
        if answer == "\x03":
            somebody.interrupts()
        else:
            somebody.types(answer)
        assert somebody.reads_to_the_end() == code
        assert "Nothing was moved." in somebody.seen and "Traceback" not in somebody.seen
        np.testing.assert_allclose(np.degrees(robot.joints), 0.0, atol=1e-6)
    somebody = person(*NEAR, *robot.here)
    somebody.reads_until("[y/N]")
    somebody.types("y\n")
    somebody.reads_until("\r[")

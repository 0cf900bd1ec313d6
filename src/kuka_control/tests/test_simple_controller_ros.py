"""The simple controller as a program, on the simulated robot."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from kst import KstClient
from rig_simulation.control_port import ControlClient

pytestmark = [pytest.mark.ros, pytest.mark.clock]

CONFIG = Path(__file__).parents[1] / "config"
MOVE_S = 60.0
"""Longest wait for a motion; the machine may be busy."""

NEAR, FAR = [0, 5, 0, -10, 0, 5, 0], [60, 20, 0, -100, 0, 40, 0]
SLOW, QUICK = ("--velocity", "0.1"), ("--velocity", "0.2")
READY = re.compile(r"listening on 127\.0\.0\.1:(\d+), control port 127\.0\.0\.1:(\d+)")


class Robot:
    """The simulated robot, and the truth about it."""

    def __init__(self, port: int, truth: ControlClient) -> None:
        self.port, self.ask = port, truth.ask

    @property
    def degrees(self) -> np.ndarray:
        return np.degrees(self.ask("state")["joints"])

    @property
    def here(self) -> tuple[str, ...]:
        return ("--ip", "127.0.0.1", "--port", str(self.port))


@pytest.fixture
def robot(processes, wait_until):
    process = processes.start("rosrun", "rig_simulation", "sunrise_controller.py", "--port", "0", "--control-port", "0")
    found = wait_until(lambda: READY.search(process.log_path.read_text()), 30.0, "the simulated robot")
    truth = ControlClient("127.0.0.1", int(found[2]), 10.0)
    yield Robot(int(found[1]), truth)
    truth.close()


@pytest.fixture
def without_master(monkeypatch, free_port):
    monkeypatch.setenv("ROS_MASTER_URI", f"http://localhost:{free_port()}")


@pytest.fixture
def start(processes):
    def start(*arguments):
        return processes.start("rosrun", "kuka_control", "simple_controller.py", *map(str, arguments))

    return start


@pytest.fixture
def run(start):
    """Runs the program to its end; returns its exit code and what it said."""

    def run(*arguments):
        process = start(*arguments)
        code = process.wait(MOVE_S)
        return code, process.log_path.read_text()

    return run


@pytest.fixture
def run_here(monkeypatch, capsys):
    """Runs the program in this process, which is quicker; for what does not come to a connection."""
    import rospy

    from kuka_control.ros import simple_program

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["simple_controller.py", *map(str, arguments)])
        monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: None)
        with pytest.raises(SystemExit) as end:
            simple_program.main()
        output = capsys.readouterr()
        return end.value.code, output.out + output.err

    handler = signal.getsignal(signal.SIGTERM)
    yield run
    signal.signal(signal.SIGTERM, handler)


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


@pytest.mark.usefixtures("without_master")
class TestWithoutMaster:
    def test_moves_to_the_given_angles_and_shows_the_progress(self, robot, run):
        code, text = run(*NEAR, "--yes", *QUICK, *robot.here)
        assert code == 0, text
        np.testing.assert_allclose(robot.degrees, NEAR, atol=0.1)
        assert "Largest step: joint 4 by -10.0 deg" in text and "The arm is at the given angles." in text
        shares = [int(share) for share in re.findall(r"\] +(\d+) %", text)]
        assert shares == sorted(shares) and shares[-1] == 100 and len(shares) >= 2
        assert not robot.ask("state")["connected"]

    def test_a_name_of_a_file_of_ones_own_and_no_motion_where_none_is_needed(self, robot, run, tmp_path):
        (tmp_path / "mine.yaml").write_text("bent: [0, 0, 0, -8, 0, 0, 0]\n")
        mine = ("bent", "--configurations", tmp_path / "mine.yaml", "--yes", *QUICK, *robot.here)
        assert run(*mine)[0] == 0
        np.testing.assert_allclose(robot.degrees, [0, 0, 0, -8, 0, 0, 0], atol=0.1)
        code, text = run(*mine)
        assert code == 0 and "The arm is at bent already; nothing was moved." in text

    @pytest.mark.parametrize(
        ("arguments", "sentence"),
        [
            (
                ["0", "0", "0", "-130", "0", "121", "0", "--yes"],
                "Joint 4 at -130 deg is out of its range of -120 to 120",
            ),
            (["home", "--yes"], "There is no joint configuration 'home'"),
            (["1", "2", "3", "--yes"], "neither one of"),
            (["--yes"], "Say where to"),
            (["zero"], "There is no terminal to ask on"),
            (["zero", "--yes", "--tool-length", "-1"], "tool_length is -1.0"),
        ],
    )
    def test_refuses_before_it_connects(self, run_here, arguments, sentence):
        code, text = run_here(*arguments, "--ip", "127.0.0.1", "--port", "1")
        assert code == 1 and sentence in text and "Connecting" not in text
        assert "Traceback" not in text

    @pytest.mark.parametrize("velocity", ["0", "1.1", "nan", "fast"])
    def test_refuses_a_velocity_out_of_range(self, run_here, velocity):
        code, text = run_here("zero", "--yes", "--velocity", velocity)
        assert code == 2 and "is not a number in (0, 1]" in text

    def test_lists_the_names(self, run_here):
        code, text = run_here("--list")
        assert code == 0
        assert [line.split()[0] for line in text.splitlines()] == ["zero", "hand_mounting", "camera_calibration"]
        assert "0, 20, 10, -110, 0, 90, -45 deg" in text

    def test_an_absent_robot_is_one_sentence(self, run, free_port):
        code, text = run("zero", "--yes", "--ip", "127.0.0.1", "--port", free_port())
        assert code == 1 and "There is no connection to the robot" in text
        assert len(text.splitlines()) == 2, text

    def test_a_robot_that_serves_somebody_else_is_said_to_be_busy(self, robot, run):
        with KstClient.connect("127.0.0.1", robot.port):
            code, text = run("zero", "--yes", *robot.here)
        assert code == 1 and "serves one program at a time" in text and "Traceback" not in text

    def test_slows_a_motion_at_which_the_robot_would_stop_on_its_way(self, robot, run):
        code, text = run(*FAR, "--yes", "--velocity", "0.9", *robot.here)
        assert code == 0, text
        used = float(re.search(r"at ([0-9.]+) of full speed .*\n.*slowed from 0.9", text)[1])
        assert 0.15 < used < 0.5
        np.testing.assert_allclose(robot.degrees, FAR, atol=0.1)
        truth = robot.ask("state")
        assert truth["stops"] == 0 and 0.5 < truth["max_tcp_speed"] < 0.8

    def test_an_interruption_says_that_the_arm_continues_and_closes(self, robot, start, wait_until):
        process = start(*FAR, "--yes", *SLOW, *robot.here)
        wait_until(lambda: robot.degrees[3] < -5.0, MOVE_S, "the motion")
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 130
        text = process.log_path.read_text()
        assert "cannot stop a PTP motion" in text and "smartPad" in text and "connection is closed" in text
        assert "Traceback" not in text
        wait_until(lambda: np.allclose(robot.degrees, FAR, atol=0.1), MOVE_S, "the motion's end")

    def test_an_arm_that_stands_still_is_said_and_waited_for(self, robot, start, wait_until):
        process = start(*FAR, "--yes", *SLOW, *robot.here)
        wait_until(lambda: robot.degrees[3] < -5.0, MOVE_S, "the motion")
        robot.ask("set_external_torque", value=[0, 0, 0, 40, 0, 0, 0])
        wait_until(lambda: "The arm does not move" in process.log_path.read_text(), MOVE_S, "the sentence")
        robot.ask("set_external_torque", value=[0] * 7)
        robot.ask("release")
        assert process.wait(MOVE_S) == 0, process.log_path.read_text()
        np.testing.assert_allclose(robot.degrees, FAR, atol=0.1)

    def test_a_robot_that_goes_away_during_the_motion_is_one_sentence(self, processes, start, wait_until):
        simulation = processes.start(
            "rosrun", "rig_simulation", "sunrise_controller.py", "--port", "0", "--control-port", "0"
        )
        found = wait_until(lambda: READY.search(simulation.log_path.read_text()), 30.0, "the simulated robot")
        process = start(*FAR, "--yes", *SLOW, "--ip", "127.0.0.1", "--port", found[1])
        wait_until(lambda: " %" in process.log_path.read_text(), MOVE_S, "the progress")
        processes.end(simulation)
        assert process.wait(MOVE_S) == 1
        text = process.log_path.read_text()
        assert "Traceback" not in text and "simple_controller: " in text

    def test_asks_and_moves_on_yes_with_a_live_bar(self, robot, person):
        somebody = person(*NEAR, *QUICK, *robot.here)
        somebody.reads_until("Move the arm to the given angles? [y/N]")
        assert "Largest step" in somebody.seen
        np.testing.assert_allclose(robot.degrees, 0.0, atol=1e-6)
        somebody.types("y\n")
        assert somebody.reads_to_the_end() == 0
        assert somebody.seen.count("\r[") >= 3 and "100 %" in somebody.seen
        np.testing.assert_allclose(robot.degrees, NEAR, atol=0.1)

    @pytest.mark.parametrize(("answer", "code"), [("n\n", 1), ("\x04", 1), ("\x03", 130)])
    def test_without_a_yes_nothing_moves(self, robot, person, answer, code):
        somebody = person(*NEAR, *robot.here)
        somebody.reads_until("[y/N]")
        time.sleep(0.5)  # as a person reads first: the program has begun to wait for the answer
        if answer == "\x03":
            somebody.interrupts()
        else:
            somebody.types(answer)
        assert somebody.reads_to_the_end() == code
        assert "Nothing was moved." in somebody.seen and "Traceback" not in somebody.seen
        np.testing.assert_allclose(robot.degrees, 0.0, atol=1e-6)


class TestWithMaster:
    def params(self, name="kuka_params_rt.yaml", **changes):
        import rospy

        rospy.set_param("kuka", {**yaml.safe_load((CONFIG / name).read_text()), **changes})

    def test_takes_the_robot_from_the_parameters_and_is_a_node(self, ros, robot, start, wait_until):
        import rosgraph

        self.params("kuka_params_ptp.yaml", ip="127.0.0.1", port=robot.port)
        process = start(*FAR, "--yes", *QUICK)
        master = rosgraph.Master("/test")

        def registered():
            with contextlib.suppress(rosgraph.MasterError):
                return master.lookupNode("/kuka_simple_node")

        wait_until(registered, MOVE_S, "the node")
        assert process.wait(MOVE_S) == 0, process.log_path.read_text()
        np.testing.assert_allclose(robot.degrees, FAR, atol=0.1)
        assert not registered()

    def test_bad_parameters_are_said_with_their_names(self, ros, run_here):
        self.params(robot="UR5", port=-1)
        code, text = run_here("zero", "--yes")
        assert code == 1 and "kuka/robot is 'UR5'" in text and "kuka/port is -1" in text

    def test_refuses_while_a_controller_holds_the_robot(self, ros, robot, run, wait_until):
        self.params(ip="127.0.0.1", port=robot.port)
        ros.run("kuka_control", "real_time_controller.py")
        wait_until(lambda: robot.ask("state")["connected"], MOVE_S, "the controller")
        code, text = run("zero", "--yes")
        assert code == 1 and "kuka_real_time_node is running" in text and "exit_app" in text
        assert "Connecting" not in text

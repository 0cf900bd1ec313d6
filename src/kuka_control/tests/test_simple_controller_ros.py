"""The simple controller as a program, on the simulated robot."""

from __future__ import annotations

import re
import signal

import numpy as np
import pytest
from controller_rig import MOVE_S, PTP, REAL_TIME, run_robot, set_params

from common import clock
from kst import KstClient

pytestmark = pytest.mark.ros

NEAR, FAR = [0, 5, 0, -10, 0, 5, 0], [60, 20, 0, -100, 0, 40, 0]
SLOW, QUICK = ("--velocity", "0.1"), ("--velocity", "0.2")


@pytest.fixture
def robot(ros):
    robot = run_robot(ros, ros.wait_until, "--port", "0", "--control-port", "0")
    robot.here = ("--ip", "127.0.0.1", "--port", robot.port)
    return robot


@pytest.fixture
def start(ros):
    def start(*arguments):
        return ros.run("kuka_control", "simple_controller.py", *map(str, arguments))

    return start


@pytest.fixture
def run(start):
    """Runs the program to its end; returns its exit code and what it said."""

    def run(*arguments):
        process = start(*arguments)
        code = process.wait(MOVE_S)
        assert "Traceback" not in process.log, process.log
        return code, process.log

    return run


def degrees(robot):
    return np.degrees(robot.joints)


class TestWithoutMaster:
    @pytest.fixture(autouse=True)
    def without_master(self, ros):
        ros.master_answers = False

    def test_moves_to_the_given_angles_and_shows_the_progress(self, robot, run):
        code, text = run(*NEAR, "--yes", *QUICK, *robot.here)
        assert code == 0, text
        np.testing.assert_allclose(degrees(robot), NEAR, atol=0.1)
        assert "Largest step: joint 4 by -10.0 deg" in text and "The arm is at the given angles." in text
        tenths = [int(share) // 10 for share in re.findall(r"\] +(\d+) %", text)]
        assert tenths == sorted(set(tenths)) and tenths[-1] == 10 and len(tenths) >= 4
        assert not robot.ask("state")["connected"]

    def test_a_name_of_a_file_of_ones_own_and_no_motion_where_none_is_needed(self, robot, run, tmp_path):
        (tmp_path / "mine.yaml").write_text("bent: [0, 0, 0, -8, 0, 0, 0]\n")
        mine = ("bent", "--configurations", tmp_path / "mine.yaml", "--yes", *QUICK, *robot.here)
        assert run(*mine)[0] == 0
        np.testing.assert_allclose(degrees(robot), [0, 0, 0, -8, 0, 0, 0], atol=0.1)
        code, text = run(*mine)
        assert code == 0 and "The arm is at bent already; nothing was moved." in text

    @pytest.mark.parametrize(
        ("arguments", "sentence"),
        [
            (["home", "--yes"], "There is no joint configuration 'home'"),
            (["--yes"], "Say where to"),
            (["zero"], "There is no terminal to ask on"),
            (["zero", "--yes", "--tool-length", "-1"], "tool_length is -1.0"),
        ],
    )
    def test_refuses_before_it_connects(self, run, arguments, sentence):
        code, text = run(*arguments, "--ip", "127.0.0.1", "--port", "1")
        assert code == 1 and sentence in text and "Connecting" not in text

    @pytest.mark.parametrize("velocity", ["0", "1.1", "nan", "fast"])
    def test_refuses_a_velocity_out_of_range(self, run, velocity):
        code, text = run("zero", "--yes", "--velocity", velocity)
        assert code == 2 and "is not a number in (0, 1]" in text

    def test_lists_the_names(self, run):
        code, text = run("--list")
        assert code == 0
        assert [line.split()[0] for line in text.splitlines()] == ["zero", "hand_mounting", "camera_calibration"]
        assert "0, 20, 10, -110, 0, 90, -45 deg" in text

    def test_an_absent_robot_is_one_sentence(self, run):
        code, text = run("zero", "--yes", "--ip", "127.0.0.1", "--port", 1)
        assert code == 1 and "There is no connection to the robot" in text
        assert len(text.splitlines()) == 2, text

    def test_a_robot_that_serves_somebody_else_is_said_to_be_busy(self, robot, run):
        with KstClient.connect("127.0.0.1", robot.port):
            code, text = run("zero", "--yes", *robot.here)
        assert code == 1 and "serves one program at a time" in text

    def test_slows_a_motion_at_which_the_robot_would_stop_on_its_way(self, robot, run):
        code, text = run(*FAR, "--yes", "--velocity", "0.9", *robot.here)
        assert code == 0, text
        used = float(re.search(r"at ([0-9.]+) of full speed .*\n.*slowed from 0.9", text)[1])
        assert 0.15 < used < 0.5
        np.testing.assert_allclose(degrees(robot), FAR, atol=0.1)
        truth = robot.ask("state")
        assert truth["stops"] == 0 and 0.5 < truth["max_tcp_speed"] < 0.8

    def test_an_interruption_says_that_the_arm_continues_and_closes(self, ros, robot, start):
        process = start(*FAR, "--yes", *SLOW, *robot.here)
        ros.wait_until(lambda: degrees(robot)[3] < -5.0, MOVE_S, "the motion")
        process.send_signal(signal.SIGINT)
        assert process.wait(2.0) == 130
        assert "cannot stop a PTP motion" in process.log and "smartPad" in process.log
        assert "connection is closed" in process.log and "Traceback" not in process.log
        ros.wait_until(lambda: np.allclose(degrees(robot), FAR, atol=0.1), MOVE_S, "the motion's end")

    def test_an_arm_that_stands_still_is_said_and_waited_for(self, ros, robot, start):
        process = start(*FAR, "--yes", *SLOW, *robot.here)
        ros.wait_until(lambda: degrees(robot)[3] < -5.0, MOVE_S, "the motion")
        robot.ask("set_external_torque", value=[0, 0, 0, 40, 0, 0, 0])
        ros.wait_until(lambda: "The arm does not move" in process.log, MOVE_S, "the sentence")
        robot.ask("set_external_torque", value=[0] * 7)
        clock.sleep(20.0)
        assert process.poll() is None
        robot.ask("release")
        assert process.wait(MOVE_S) == 0, process.log
        np.testing.assert_allclose(degrees(robot), FAR, atol=0.1)

    def test_a_robot_that_goes_away_during_the_motion_is_one_sentence(self, ros, robot, start):
        process = start(*FAR, "--yes", *SLOW, *robot.here)
        ros.wait_until(lambda: " %" in process.log, MOVE_S, "the progress")
        robot.process.send_signal(signal.SIGTERM)
        assert process.wait(5.0) == 1
        assert "Traceback" not in process.log and process.log.count("simple_controller: ") == 1


class TestWithMaster:
    def test_takes_the_robot_from_the_parameters_and_is_a_node(self, robot, start):
        set_params(PTP, ip="127.0.0.1", port=robot.port)
        process = start(*FAR, "--yes", *QUICK)
        clock.sleep(3.0)
        assert process.name == "/kuka_simple_node"
        assert process.wait(MOVE_S) == 0, process.log
        np.testing.assert_allclose(degrees(robot), FAR, atol=0.1)

    def test_refuses_while_a_controller_holds_the_robot(self, ros, robot, run):
        set_params(REAL_TIME, ip="127.0.0.1", port=robot.port)
        ros.run("kuka_control", REAL_TIME)
        clock.sleep(3.0)
        code, text = run("zero", "--yes")
        assert code == 1 and "kuka_real_time_node is running" in text and "exit_app" in text
        assert "Connecting" not in text

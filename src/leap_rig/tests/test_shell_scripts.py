"""The two shell scripts, from a terminal in which nothing was sourced."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros

SHELL = Path(__file__).resolve().parents[1] / "shell"


@pytest.fixture
def bare(processes, tmp_path):
    """Starts a script of the folder shell in an environment without the workspace; further variables may be given."""

    def start(script: str, *arguments: str, **environment: str):
        settings = {"HOME": str(tmp_path), "PATH": "/usr/sbin:/usr/bin:/sbin:/bin", **environment}
        return processes.start("env", "-i", *(f"{k}={v}" for k, v in settings.items()), str(SHELL / script), *arguments)

    return start


def log(process):
    return process.log_path.read_text()


def test_run_leapd_starts_the_simulated_leap_service(bare, wait_until):
    process = bare("run_leapd.sh", "--sim", "--port", "0", "--control-port", "0")
    wait_until(lambda: "leapd: listening on" in log(process) or process.poll() is not None, 30.0, "the ready line")
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0, log(process)


def test_run_leapd_names_a_missing_leap_service(bare):
    process = bare("run_leapd.sh")
    assert process.wait(30) == 1
    assert "The Leap service (leapd) is not installed." in log(process)


@pytest.mark.rig
@pytest.mark.timeout(300)
def test_run_leap_control_starts_the_rig_and_the_real_time_controller_and_ends_both(bare, free_port, wait_until):
    ports = ("robot_port", "robot_control_port", "leap_port", "leap_control_port", "hand_control_port", "world_port")
    arguments = [f"{name}:={free_port()}" for name in ports]
    process = bare(
        "run_leap_control.sh", *arguments, f"hand_port:={free_port(socket.SOCK_DGRAM)}",
        ROS_MASTER_URI=f"http://localhost:{free_port()}", ROS_HOSTNAME="localhost",
    )  # fmt: skip

    wait_until(lambda: "The arm is at home." in log(process) or process.poll() is not None, 60.0, "the arm at home")
    assert process.poll() is None, log(process)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C in a terminal
    process.wait(40)
    assert "killing on exit" in log(process) and "Traceback" not in log(process)

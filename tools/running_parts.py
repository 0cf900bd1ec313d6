"""The launch files of the ROS graph page: each part runs on a ROS master, ports and a screen of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import rosgraph

from simulated.ports import free_port, ports_of_a_rig
from tools import launched
from tools.handbook.walk import screen

ONE_PROCESS, NO_SCREEN = "one_process:=true", ("rviz:=false", "gui:=false")
END_S = 40.0
"""Longest wait for a program to exit after Ctrl-C [s]."""


@dataclass(frozen=True)
class Part:
    """A part of the page.

    Attributes:
        title: its heading.
        says: what runs, for the reader.
        commands: returns what is started.
        started: returns the ROS nodes and other programs that each way to start it has, by the way's name."""

    title: str
    says: str
    commands: Callable[[], list[list[str]]]
    started: Callable[[], dict[str, set[str]]] = dict


def _given(ports: dict[str, int], *names: str) -> list[str]:
    return [f"{name}:={ports[name]}" for name in names or ports]


def _rig() -> list[list[str]]:
    arguments = ["rviz:=false", ONE_PROCESS, "grasping:=true", "camera_rate:=1", *_given(ports_of_a_rig())]
    return [["roslaunch", "leap_rig", "demo.launch", *arguments], ["roslaunch", "grasping", "collect.launch"]]


def _ways() -> dict[str, set[str]]:
    """Returns what the ways to start the rig start; the first is the demo's least, which the others have or change."""
    headless = (*NO_SCREEN, ONE_PROCESS)
    return {
        "make demo HEADLESS=1": _nodes(*headless),
        "make demo": _nodes("rviz:=true", "gui:=true", ONE_PROCESS),
        'make demo HEADLESS=1 ARGS="grasping:=true"': _nodes(*headless, "grasping:=true"),
        "make demo HEADLESS=1 TRACKER=none": _nodes(*headless, "tracker:=none"),
        "roslaunch leap_rig demo.launch rviz:=false gui:=false": _nodes(*NO_SCREEN),
        "roslaunch leap_rig demo.launch rviz:=false gui:=false sim:=false": _nodes(*NO_SCREEN, "sim:=false"),
        "roslaunch grasping collect.launch": launched.nodes("grasping", "collect.launch"),
    }


def _nodes(*arguments: str) -> set[str]:
    return launched.nodes("leap_rig", "demo.launch", *arguments)


def _ptp() -> list[list[str]]:
    ports = ports_of_a_rig()
    wire = ["robot_ip:=127.0.0.1", "leap_host:=127.0.0.1", "hand_interface:=lo"]
    return [
        ["roslaunch", "leap_rig", "simulated_devices.launch", *_given(ports)],
        [
            "roslaunch",
            "leap_rig",
            "rig.launch",
            "mode:=ptp",
            *wire,
            *_given(ports, "robot_port", "leap_port", "hand_port"),
        ],
        [
            *("roslaunch", "kuka_control", "ptp_controller.launch", "gui:=false"),
            *("ip:=127.0.0.1", f"port:={ports['robot_port']}"),
        ],
    ]


def _vision() -> list[list[str]]:
    port, hand = str(free_port()), str(free_port(socket.SOCK_DGRAM))
    any_free = [word for name in ("port", "control-port", "hand-control-port") for word in (f"--{name}", "0")]
    any_free += ["--hand-port", hand, "--world-port", port]
    return [
        ["rosrun", "rig_simulation", "world.py", "--scene", "empty", "--panel", *any_free],
        [
            *("roslaunch", "vision", "camera_apriltag.launch", "sim:=true"),
            *("description:=true", f"port:={port}", "control_port:=0"),
        ],
        ["roslaunch", "vision", "register_rgbd.launch", "camera:=false", "rviz:=false", "nodelets:=false"],
        ["roslaunch", "vision", "plane_pose.launch", "camera:=false"],
        ["roslaunch", "vision", "camera_oculus.launch", "camera:=false", "web:=true", "web_port:=0"],
    ]  # fmt: skip


PARTS = {
    "rig": Part(
        "The rig",
        "`make demo` with `grasping:=true`, without RViz, and `roslaunch grasping collect.launch`. `leap_teleop` is "
        "`leap_driver`, `leap_kuka_node` and `leap_hand_node` in one process; by `roslaunch` alone they are three "
        "nodes with the same topics and services, unless `one_process:=true` is given.",
        _rig,
        _ways,
    ),
    "ptp": Part(
        "The PTP controller",
        "`roslaunch leap_rig leap_rig_ptp_debug.launch sim:=true` and "
        "`roslaunch kuka_control ptp_controller.launch sim:=true`: differences from the rig above.",
        _ptp,
    ),
    "vision": Part(
        "Calibration, depth and headset",
        "`roslaunch vision camera_apriltag.launch sim:=true description:=true`, and with `camera:=false` beside it "
        "`register_rgbd.launch`, `plane_pose.launch` and `camera_oculus.launch web:=true`: "
        "differences from the rig above.",
        _vision,
    ),
}
"""By command-line name; the first one is the rig, the others show differences from it."""


@contextlib.contextmanager
def running(part: Part) -> Iterator[None]:
    """Runs a part on a ROS master of its own, which this process then uses. Raises SystemExit: a command ended at once;
    with what it printed."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder, screen() as display:
        os.environ.update(
            ROS_MASTER_URI=f"http://localhost:{port}", ROS_HOSTNAME="localhost", ROS_HOME=folder, DISPLAY=display
        )
        os.environ["LEAP_RIG_NICENESS"] = "0"  # nothing has to keep a rate, and what yields would start last
        core = _start(["roscore", "-p", str(port)], Path(folder) / "roscore.log")
        programs = {}
        try:
            while not rosgraph.is_master_online():
                time.sleep(0.2)
            for number, command in enumerate(part.commands()):
                log = Path(folder) / f"{number}.log"
                programs[log] = _start(command, log)
            time.sleep(1.0)
            for log, program in programs.items():
                if program.poll() is not None:
                    raise SystemExit(f"{program.args!r} ended:\n{log.read_text(errors='replace')}")
            yield
        finally:
            _end(*programs.values())
            _end(core)


def _start(command: list[str], log: Path) -> subprocess.Popen:
    with open(log, "wb") as output:
        return subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)


def _end(*programs: subprocess.Popen) -> None:
    """Interrupts them all at once, as each takes some seconds to end, and waits."""
    for program in programs:
        program.send_signal(signal.SIGINT)
    for program in programs:
        with contextlib.suppress(subprocess.TimeoutExpired):
            program.wait(END_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)

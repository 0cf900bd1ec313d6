"""The program demo.py as a process, on ports of its own: start, interrupts, what it leaves; and one demo as a whole."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import sys
from pathlib import Path

import pytest
import yaml

from campaign.trial import runs
from rig_simulation.control_port import ControlClient

pytestmark = [pytest.mark.ros, pytest.mark.timeout(400)]

WITHOUT_WORLD = {"world": "false"}
"""For tests in which nothing is touched: physics takes much of a small machine."""
EASY = {
    "time_out": 10.0, "rate_servo": 100.0, "rate_joints": 25.0, "rate_state": 10.0,
    "velocity_ptp_slow": 0.6, "velocity_ptp_fast": 0.6,
}  # fmt: skip
"""Lower rates, a longer time-out and quicker motions home, for all but the runs with the parameters as shipped."""


@pytest.fixture
def demo(processes, free_port, tmp_path):
    """Starts the demo on free ports with a master of its own; returns the process, which has its report and ports."""

    def start(*arguments: str, within: tuple[str, ...] = (), easy: bool = True, **launch):
        report, overrides = tmp_path / "report.json", tmp_path / "overrides.yaml"
        overrides.write_text(yaml.safe_dump(EASY))
        ports = ("robot", "robot_control", "leap", "leap_control", "hand_control", "world", "camera_control")
        launch = {
            **{f"{name}_port": free_port() for name in ports},
            "hand_port": free_port(socket.SOCK_DGRAM),
            **launch,
        }
        if easy:
            launch = {"overrides": overrides, "leap_args": "--frame-rate 60", **launch}
        master = f"http://localhost:{free_port()}"
        process = processes.start(
            *within, "rosrun", "leap_rig", "demo.py", "--headless", "--report", str(report), *arguments,
            "--", *(f"{name}:={value}" for name, value in launch.items()),
            env={"ROS_MASTER_URI": master, "ROS_HOME": str(tmp_path / "ros"),
                 "ROS_LOG_DIR": str(tmp_path / "log")},
        )  # fmt: skip
        process.report, process.ports = report, launch
        return process

    return start


def descendants(pid: int) -> set[int]:
    children = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat") as file:
                    parent = int(file.read().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
            children.setdefault(parent, set()).add(int(entry))
    found, new = set(), {pid}
    while new:
        new = set().union(*(children.get(p, set()) for p in new))
        found |= new
    return found


ALSO_OUTSIDE = {"rosout", "robot_state_pub"}
"""roscpp's XML-RPC servers listen on all interfaces whatever the settings (docs/handbook/security.md)."""
HAND_GROUP = "224.0.0.124"


def listening(pids: set[int]) -> set[tuple[str, str, str]]:
    """Returns protocol, address and program of each socket of these processes that takes connections or datagrams."""
    owners = {}
    for pid in pids:
        with contextlib.suppress(OSError):
            name = Path(f"/proc/{pid}/comm").read_text().strip()
            for entry in Path(f"/proc/{pid}/fd").iterdir():
                with contextlib.suppress(OSError):
                    owners[os.readlink(entry)] = name
    found = set()
    for protocol, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for line in Path(f"/proc/net/{protocol}").read_text().splitlines()[1:]:
            _, local, _, now, *others = line.split()
            owner = owners.get(f"socket:[{others[5]}]")
            if owner and now == state:
                words = bytes.fromhex(local.split(":")[0])
                parts = [words[i : i + 4][::-1] for i in range(0, len(words), 4)]
                address = socket.inet_ntop(socket.AF_INET6 if len(parts) > 1 else socket.AF_INET, b"".join(parts))
                found.add((protocol, address, owner))
    return found


@pytest.mark.hazard(22)
@pytest.mark.real
def test_a_scripted_hand_moves_arm_and_hand_until_ctrl_c_and_nothing_is_left_behind(demo, wait_until, tmp_path):
    process = demo(**WITHOUT_WORLD, leap_args="--frame-rate 60 --figure line --size 40")
    read = process.log_path.read_text
    # A robot that pauses stops the arm, which then follows no hand; the end is the same.
    settled = ("| arm servo", "| arm stopped")
    wait_until(lambda: any(map(read().__contains__, settled)) or process.poll() is not None, 90.0, "the arm to follow")
    assert process.poll() is None, read()
    with ControlClient("127.0.0.1", process.ports["hand_control_port"], 60.0) as hand:
        wait_until(lambda: max(hand.ask("state")["angles"]) > 1.0, 90.0, "the robot hand to close")
    lines = read().count(" | arm ")
    wait_until(lambda: read().count(" | arm ") > lines, 90.0, "the demo to have seen that")
    sockets = listening({process.pid, *descendants(process.pid)})
    assert {program for _, _, program in sockets} >= {"rosmaster", "rosout", "leapd.py"}
    outside = {entry for entry in sockets if not entry[1].startswith("127.") and entry[1] != HAND_GROUP}
    assert {(protocol, program) for protocol, _, program in outside} <= {("tcp", program) for program in ALSO_OUTSIDE}
    process.send_signal(signal.SIGINT)
    code, summary = process.wait(200), json.loads(process.report.read_text())
    assert code == bool(summary["faults"]), read()
    assert "Leap Rig: " in read()
    assert summary["faults"] or (summary["frames_received"] and summary["streams"])
    wait_until(lambda: not started_by(tmp_path), 20.0, "the end of all nodes")


def command_line(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path("/proc", str(pid), "cmdline").read_text().replace("\0", " ")
    return ""


def started_by(folder) -> list[str]:
    """Returns the programs that a demo of this folder started, whoever their parent is by now."""
    programs = []
    for entry in os.listdir("/proc"):
        with contextlib.suppress(OSError):
            if entry.isdigit() and f"ROS_LOG_DIR={folder}/".encode() in Path("/proc", entry, "environ").read_bytes():
                programs.append(command_line(int(entry)))
    return programs


@pytest.mark.long
@pytest.mark.parametrize(("nodes", "number"), [(3, signal.SIGINT), (6, signal.SIGTERM), (9, signal.SIGINT)])
def test_an_interrupt_while_the_rig_starts_ends_everything(demo, wait_until, tmp_path, nodes, number):
    process = demo()
    counts = descendants, lambda _: started_by(tmp_path)  # a program that just begins has no environment yet
    wait_until(lambda: all(len(count(process.pid)) > nodes for count in counts), 60.0, "the first nodes")
    process.send_signal(number)
    assert process.wait(60) in (1, 2), process.log_path.read_text()
    log = process.log_path.read_text()
    assert "demo: interrupted" in log or "Leap Rig: " in log
    wait_until(lambda: not started_by(tmp_path), 10.0, "the end of all")


IN_A_TERMINAL = (sys.executable, "-c", "import pty, sys; pty.spawn(sys.argv[1:])")
"""Runs a command in a terminal of its own, as a window does; the terminal closes when this program ends."""
IN_THE_BACKGROUND = ("sh", "-c", 'trap "" INT; exec "$@"', "sh")
"""Runs a command without interrupts, as the shell of a script does with what ends by &."""


def log_of_the_arm(folder: Path) -> str:
    """Returns what the arm's controller has logged, of a demo of this folder."""
    return "".join(path.read_text() for path in folder.glob("log/*/kuka_real_time_node-*.log"))


def ends_with_everything_that_it_started(process, number, wait_until, tmp_path):
    """Sends it a signal, which must end it with all its nodes, and the controller in order."""
    everything = {process.pid, *descendants(process.pid)}

    def ends():
        process.send_signal(number)  # again and again, as somebody does who is impatient
        return not any(map(runs, everything))

    try:
        wait_until(ends, 30.0, "the end of everything")
    finally:
        for pid in filter(runs, everything):
            os.kill(pid, signal.SIGKILL)
    assert "The connection to the robot is closed." in log_of_the_arm(tmp_path)


@pytest.mark.long
def test_in_a_terminal_that_is_closed_everything_ends(demo, wait_until, tmp_path):
    process = demo(within=IN_A_TERMINAL, **WITHOUT_WORLD)
    wait_until(lambda: " s | arm servo" in process.log_path.read_text(), 90.0, "the arm to follow")
    ends_with_everything_that_it_started(process, signal.SIGKILL, wait_until, tmp_path)


@pytest.mark.long
def test_a_recording_is_played_from_a_folder_with_a_space_in_its_name_until_an_interrupt_in_the_background(
    demo, shared_data, wait_until, tmp_path
):
    folder = tmp_path / "my recordings"
    folder.mkdir()
    recording = shutil.copy(shared_data / "leap" / "rollAndPitchWithEntry.jsonl.gz", folder)
    play = ("--recording", recording, "--offset", "0", "150", "30")  # in each round the hand comes into the box
    process = demo(*play, within=IN_THE_BACKGROUND, easy=False, **WITHOUT_WORLD)
    seconds = re.compile(r"(\d+) s \| arm")
    wait_until(
        lambda: any(int(n) >= 15 for n in seconds.findall(process.log_path.read_text())), 120.0, "15 s of the recording"
    )
    wait_until(lambda: "leaves servo mode" in log_of_the_arm(tmp_path), 60.0, "a round that the arm followed")
    ends_with_everything_that_it_started(process, signal.SIGINT, wait_until, tmp_path)
    assert "Leap Rig: " in process.log_path.read_text()
    summary = json.loads(process.report.read_text())
    assert summary["faults"] == [] and summary["safety_stops"] == 0, process.log_path.read_text()
    assert summary["streams"] and summary["frames_received"] > 500 and summary["servo_goals_sent"] > 0
    assert 0.0 < summary["largest_tcp_speed_mm_s"] < 800.0

"""The two shell scripts, from a terminal in which nothing was sourced."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("rig_msgs.srv")
from tools import launched

pytestmark = [pytest.mark.ros, pytest.mark.real]

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


@pytest.mark.long
def test_run_leapd_starts_the_simulated_leap_service(bare, wait_until):
    process = bare("run_leapd.sh", "--sim", "--port", "0", "--control-port", "0")
    wait_until(lambda: "leapd: listening on" in log(process) or process.poll() is not None, 30.0, "the ready line")
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0, log(process)


INSTALLED = [
    (("leapd",), False, "Leap service 2.3", ["leapd --config=x"]),
    (
        *(("leapd", "leapctl", "Ultraleap-Tracking-WS"), False, "Today's Ultraleap software"),
        ["systemctl start ultraleap-hand-tracking-service", "Ultraleap-Tracking-WS --config=x"],
    ),
    (("leapd", "leapctl", "Ultraleap-Tracking-WS"), True, "Today's", ["Ultraleap-Tracking-WS --config=x"]),
    (("leapd", "leapctl"), True, "not its WebSocket server", []),
    (("Ultraleap-Tracking-WS",), None, "does not start", []),
    ((), False, "No Leap service is installed", []),
]


def test_run_leapd_starts_the_service_that_is_installed_and_says_which(tmp_path):
    """`running`: whether the tracking service runs already, None: it does not start."""
    for number, (installed, running, said, started) in enumerate(INSTALLED):
        folder = tmp_path / str(number)
        folder.mkdir()
        active, start = (0, 0) if running else (3, 1) if running is None else (3, 0)
        programs = {name: f'echo "{name} $*" >> "$LOG"' for name in installed}
        programs["systemctl"] = (
            f'[ "$1" = is-active ] && exit {active}; [ {start} = 0 ] && echo "systemctl $*" >> "$LOG"'
        )
        programs["sudo"] = '"$@"'
        for name, body in programs.items():
            (folder / name).write_text(f"#!/bin/sh\n{body}\n")
            (folder / name).chmod(0o755)
        environment = {"PATH": f"{folder}:/usr/bin:/bin", "LOG": str(folder / "log")}
        (folder / "log").touch()
        done = subprocess.run([SHELL / "run_leapd.sh", "--config=x"], env=environment, capture_output=True, text=True)
        assert said in done.stdout + done.stderr
        assert (folder / "log").read_text().splitlines() == started
        assert (done.returncode == 0) == bool(started)


@pytest.mark.long
@pytest.mark.parametrize("words", [("--sim",), ("sim:=true",), ("sim:=false", "--sim")])
def test_run_leap_control_refuses_a_busy_leap_port_in_a_sentence(words):
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        done = subprocess.run(
            [SHELL / "run_leap_control.sh", *words, f"leap_port:={port}"], capture_output=True, text=True
        )
    assert done.returncode == 1 and f"Port {port} is busy" in done.stderr and done.stdout == ""


WORDS = [
    ((), "sim:=false"),
    (("gui:=false", "robot_ip:=10.0.0.1"), "sim:=false gui:=false robot_ip:=10.0.0.1"),
    (("--sim", "leap_port:=1"), "sim:=true leap_port:=1"),
    (("sim:=true", "sim:=false"), "sim:=false"),
    (("sim:=1", "leap_port:=1"), "sim:=true leap_port:=1"),
    (("--sim", "sim:=False"), "sim:=false"),
]


@pytest.mark.parametrize("words, launched", WORDS)
def test_run_leap_control_is_for_the_real_rig_unless_asked_otherwise(tmp_path, words, launched):
    """With a roslaunch that only notes how it is called."""
    folder = tmp_path / "src" / "leap_rig" / "shell"
    folder.mkdir(parents=True)
    for name in ("run_leap_control.sh", "workspace.sh"):
        (folder / name).write_text((SHELL / name).read_text())
    (tmp_path / "devel").mkdir()
    (tmp_path / "devel" / "setup.bash").touch()
    (tmp_path / "roslaunch").write_text('#!/bin/sh\necho "$*"\nexit 3\n')
    (tmp_path / "roslaunch").chmod(0o755)
    environment = {"PATH": f"{tmp_path}:/usr/bin:/bin"}
    done = subprocess.run(
        ["bash", folder / "run_leap_control.sh", *words], env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (3, f"leap_rig leap_rig.launch controller:=true {launched}\n")


def test_the_controller_that_is_launched_with_the_rig_ends_it():
    for asked in ("true", "false"):
        nodes = launched.config("leap_rig", "leap_rig.launch", (f"controller:={asked}",)).nodes
        found = [
            (node.type, node.required) for node in nodes if node.package == "kuka_control" and "controller" in node.type
        ]
        assert found == ([("real_time_controller.py", True)] if asked == "true" else [])


LAYOUTS = {  # folder of the scripts, what is built, whether the terminal has a workspace: what is sourced
    "a clone of its own": ("src/leap_rig/shell", ["devel"], False, "devel"),
    "a clone in a workspace": ("src/rig/src/leap_rig/shell", ["devel"], False, "devel"),
    "both": ("src/rig/src/leap_rig/shell", ["devel", "src/rig/devel"], False, "src/rig/devel"),
    "an install space": ("install/share/leap_rig/shell", ["install"], False, "install"),
    "an install space beside a devel space": ("install/share/leap_rig/shell", ["devel", "install"], False, "install"),
    "the terminal's": ("src/rig/src/leap_rig/shell", ["devel", "src/rig/devel"], True, None),
    "nothing built": ("src/leap_rig/shell", [], False, None),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_scripts_find_the_workspace_around_them(tmp_path, layout):
    scripts, built, sourced, expected = LAYOUTS[layout]
    folder = tmp_path / scripts
    folder.mkdir(parents=True)
    (folder / "workspace.sh").write_text((SHELL / "workspace.sh").read_text())
    for space in built:
        (tmp_path / space).mkdir(parents=True, exist_ok=True)
        (tmp_path / space / "setup.bash").write_text(f"echo {space}\n")
        (tmp_path / space / "local_setup.bash").touch()
    (tmp_path / "rospack").write_text(f"#!/bin/sh\nexit {0 if sourced else 1}\n")
    (tmp_path / "rospack").chmod(0o755)
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", f"source {folder}/workspace.sh; echo started"],
        env={"PATH": f"{tmp_path}:/usr/bin:/bin"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.split() == [*([expected] if expected else []), *(["started"] if built else [])]
    assert ("nothing was started" in done.stderr) is (not built) is (done.returncode == 1)


HOOK = SHELL.parents[1] / "common" / "env-hooks" / "50.leap_rig.sh.in"
SOURCED = {  # workspaces sourced one after the other, PATH before: PATH after; a and b have a .venv, c has none
    "first": ("a", "/usr/bin:/bin", "a:/usr/bin:/bin"),
    "again": ("aaa", "/usr/bin:/bin", "a:/usr/bin:/bin"),
    "the last one is first": ("aba", "/usr/bin:/bin", "a:b:/usr/bin:/bin"),
    "between others": ("a", "/usr/bin:a:/bin:a", "a:/usr/bin:/bin"),
    "twice in a row": ("a", "/bin:a:a:b", "a:/bin:b"),
    "alone": ("a", "a", "a"),
    "without an environment": ("ac", "/bin", "a:/bin"),
}


@pytest.mark.parametrize("case", SOURCED)
def test_the_python_of_the_workspace_sourced_last_is_first(tmp_path, case):
    workspaces, before, after = SOURCED[case]
    for name in "abc":
        python = tmp_path / name / ".venv" / "bin" / "python"
        python.parent.mkdir(parents=True)
        python.touch(0o644 if name == "c" else 0o755)
        (tmp_path / f"{name}.sh").write_text(HOOK.read_text().replace("@CLONE@", str(tmp_path / name)))

    def path(text):
        return ":".join(f"{tmp_path}/{part}/.venv/bin" if part in ("a", "b") else part for part in text.split(":"))

    hooks = " ".join(f". {tmp_path}/{name}.sh;" for name in workspaces)
    script = ["/bin/sh", "-eu", "-c", f'{hooks} echo "$PATH"']
    done = subprocess.run(script, env={"PATH": path(before)}, capture_output=True, text=True)
    assert (done.stdout.strip(), done.stderr) == (path(after), "")


@pytest.mark.long
@pytest.mark.timeout(300)
def test_run_leap_control_starts_the_rig_and_the_real_time_controller_and_ends_both(bare, free_port, wait_until):
    ports = ("robot_port", "robot_control_port", "leap_port", "leap_control_port", "hand_control_port", "world_port")
    arguments = [f"{name}:={free_port()}" for name in ports]
    process = bare(
        "run_leap_control.sh", "--sim", *arguments, f"hand_port:={free_port(socket.SOCK_DGRAM)}",
        ROS_MASTER_URI=f"http://localhost:{free_port()}", ROS_HOSTNAME="localhost",
    )  # fmt: skip

    wait_until(lambda: "The arm is at home." in log(process) or process.poll() is not None, 60.0, "the arm at home")
    assert process.poll() is None, log(process)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C in a terminal
    process.wait(40)
    assert "killing on exit" in log(process) and "Traceback" not in log(process)

"""The whole simulated rig: delay of each stage as the demo reports it, and what share of a CPU each process takes."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from bench.measure import BenchError, Row
from common.ports import free_port

PORTS = ("robot_port", "robot_control_port", "leap_port", "leap_control_port", "hand_control_port", "world_port")
AT_HOME = " s | arm "
"""What the demo prints once the arm is at home and the operator begins."""

READY_S = 100.0
END_S = 120.0
SLICE_S = 1.0
TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


def rows(quick: bool) -> list[Row]:
    """Returns the delays and the CPU shares of one demo without a screen.

    Raises:
        BenchError: the demo did not run to its end, or found a fault.
    """
    duration, slices = (15, 5) if quick else (20, 10)
    with tempfile.TemporaryDirectory() as folder:
        report, log = Path(folder) / "report.json", Path(folder) / "demo.log"
        with open(log, "wb") as output:
            process = _start(duration, report, folder, output)
        try:
            _wait_until_home(process, log)
            shares = cpu_shares(process.pid, slices)
            process.wait(END_S)
        except subprocess.TimeoutExpired as error:
            raise BenchError(f"The demo did not end: {_last_line(log)}") from error
        finally:
            _end(process)
        if process.returncode != 0:
            raise BenchError(f"The demo found a fault: {_last_line(log)}")
        summary = json.loads(report.read_text())
    return _delay_rows(summary) + _cpu_rows(shares, slices) + _pace_rows(summary)


def cpu_shares(pid: int, slices: int) -> dict[str, np.ndarray]:
    """Returns for each program below a process, and itself, its share of one CPU in each slice of a second [%]."""
    shares: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(slices))
    before, began = _cpu_times(pid), time.monotonic()
    for i in range(slices):
        time.sleep(SLICE_S)
        now, ended = _cpu_times(pid), time.monotonic()
        for process, seconds in now.items():
            shares[process[1]][i] += 100.0 * (seconds - before.get(process, 0.0)) / (ended - began)
        before, began = now, ended
    return dict(shares)


def _start(duration: int, report: Path, folder: str, output) -> subprocess.Popen:
    launch = {name: free_port() for name in PORTS}
    launch["hand_port"] = free_port(socket.SOCK_DGRAM)
    command = ("rosrun", "leap_rig", "demo.py", "--headless", "--duration", str(duration), "--report", str(report))
    arguments = ("--", *(f"{name}:={value}" for name, value in launch.items()))
    env = {
        **os.environ,
        "ROS_MASTER_URI": f"http://localhost:{free_port()}",
        "ROS_HOME": folder,
        "ROS_LOG_DIR": f"{folder}/log",
    }
    return subprocess.Popen(
        [*command, *arguments], env=env, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
    )


def _wait_until_home(process: subprocess.Popen, log: Path) -> None:
    deadline = time.monotonic() + READY_S
    while AT_HOME not in log.read_text(errors="replace"):
        if process.poll() is not None or time.monotonic() > deadline:
            raise BenchError(f"The arm of the demo did not come home: {_last_line(log)}")
        time.sleep(0.1)


def _end(process: subprocess.Popen) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(15.0)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else "it said nothing"


def _delay_rows(summary: dict) -> list[Row]:
    length = f"a demo of {summary['duration_s']:.0f} s; the averaging of the hand is a filter and not in here"
    return [
        Row(f"demo delay, {name}", delay["p50"], delay["p99"], "ms", f"{delay['samples']} frames of {length}")
        for name, delay in summary["delay_ms"].items()
    ]


def _pace_rows(summary: dict) -> list[Row]:
    how = "seconds of the simulated world in a second of the same demo; below 0.95 the machine is too slow for it"
    return [Row("demo, real-time factor", summary["real_time_factor"], None, "", how)]


def _cpu_rows(shares: dict[str, np.ndarray], slices: int) -> list[Row]:
    how = f"{slices} slices of {SLICE_S:g} s, at the right the largest; 100 % is one of {os.cpu_count()} CPUs"
    shares = {"all processes": sum(shares.values()), **dict(sorted(shares.items(), key=lambda s: -s[1].mean()))}
    return [Row(f"demo CPU, {name}", float(np.median(s)), float(s.max()), "%", how) for name, s in shares.items()]


def _cpu_times(root: int) -> dict[tuple[int, str], float]:
    """Returns for a process and all below it, by id and name, the CPU time that it used so far [s]."""
    parents, used = {}, {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except OSError:  # it has just ended
            continue
        pid = int(entry.name)
        parents[pid] = int(fields[1])
        used[pid] = _name(words), (int(fields[11]) + int(fields[12])) * TICK_S
    found, new = set(), {root}
    while new:
        found |= new
        new = {pid for pid, parent in parents.items() if parent in new} - found
    return {(pid, used[pid][0]): used[pid][1] for pid in found if pid in used}


def _name(words: list[bytes]) -> str:
    """Returns the program of a command line: the script where Python runs one."""
    names = [Path(os.fsdecode(word)).name for word in words if word and not word.startswith(b"-")]
    if len(names) > 1 and names[0].startswith("python"):
        return names[1]
    return names[0] if names else "unknown"

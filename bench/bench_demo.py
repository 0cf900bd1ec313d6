"""The whole simulated rig: its delays as the demo reports them, and what share of a CPU each process takes."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from bench.measure import ROOT, BenchError, Goal, Row, number
from simulated.ports import free_port, ports_of_a_rig

READY = "Ready after"
"""What the demo prints once the arm may follow a hand."""

WATCHED_S = 3.0
"""The watch for the arm's arrival begins so late: it would slow the start of the rig, and the arm is on its way."""

READY_S = 100.0
END_S = 120.0
SLICE_S = 1.0
STEERING_S = 4.0  # by then the arm is at home and has picked up the hand [s]
GOALS = {
    "frame received to goal on the arm's wire": ("demo: frame to goal on the wire", Goal(2.5, 8.0)),
    "frame received to command of the hand": ("demo: frame to command of the hand", None),
}
HAND_GOAL = Goal(45.0)
CPU_GOALS = {"all processes": Goal(90.0), "world.py": Goal(25.0)}
LEAST_SHARE = 5.0  # programs that take less of a processor are not listed [%]


@dataclass(frozen=True)
class DemoRun:
    """One demo: its report, the times until the arm was at home and until it was ready for a hand [s], the CPU share of
    each program [%], and how often the measured flange came on tf [Hz]."""

    report: dict
    home_s: float
    ready_s: float
    shares: dict[str, np.ndarray]
    flange_rate: float


def rows(quick: bool) -> list[Row]:
    """Returns delays, CPU shares, time to start and rates of one demo without a screen. Raises BenchError: the demo did
    not run to its end, or found a fault."""
    slices = 4 if quick else 15
    run = run_demo(slices)
    how = f"a demo of {run.report['duration_s']:.0f} s"
    delays = run.report["delay_ms"]
    table = [
        Row(what, delays[stage]["p50"], delays[stage]["p99"], "ms", f"{delays[stage]['samples']} frames of {how}", goal)
        for stage, (what, goal) in GOALS.items()
    ]
    hand = run.report["hand_to_arm_ms"]
    table.append(
        Row("demo: palm to tool of the arm", None, None, "ms", "too little moved", HAND_GOAL)
        if hand is None
        else Row(
            "demo: palm to tool of the arm", hand["p50"], hand["p90"], "ms",
            f"{hand['windows']} windows of 4 s of {how}; the second number is the 90th percentile", HAND_GOAL,
        )
    )  # fmt: skip
    shares = {"all processes": sum(run.shares.values()), **dict(sorted(run.shares.items(), key=lambda s: -s[1].mean()))}
    how_cpu = f"{slices} slices of {SLICE_S:g} s, p99 is the largest; 100 % is one of {os.cpu_count()} CPUs"
    table += [
        Row(f"demo: CPU, {name}", float(np.median(s)), float(s.max()), "%", how_cpu, CPU_GOALS.get(name))
        for name, s in shares.items()
        if np.median(s) >= LEAST_SHARE
    ]
    return [
        *table,
        number("demo: start to arm at home", run.home_s, "s", how, Goal(7.0)),
        number("demo: start to ready for a hand", run.ready_s, "s", how),
        number("demo: measured flange on tf", run.flange_rate, "Hz", how, Goal(100.0, at_least=True)),
        number("demo: real-time factor", run.report["real_time_factor"], "", how, Goal(1.0, at_least=True)),
    ]


def run_demo(slices: int) -> DemoRun:
    """Runs a demo without a screen. Raises BenchError: the demo did not run to its end, or found a fault."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as others:
        report, log = Path(folder) / "report.json", Path(folder) / "demo.log"
        env = {
            **os.environ,
            "DISPLAY": "",
            "ROS_MASTER_URI": f"http://localhost:{free_port()}",
            "ROS_HOME": folder,
            "ROS_LOG_DIR": f"{folder}/log",
        }
        duration = slices * SLICE_S + 2.0 * STEERING_S
        arguments = ["--duration", f"{duration:g}", "--report", str(report), "--headless", "--"]
        with open(log, "wb") as output:
            began = time.monotonic()
            process = start_demo(arguments, env, output)
        try:
            time.sleep(WATCHED_S)
            watch = subprocess.Popen(HOME_WATCH, env=env, stdout=subprocess.PIPE, text=True)
            others.callback(watch.kill)
            wait_until_ready(process, log)
            ready_s = time.monotonic() - began
            home_s = float(watch.communicate(timeout=END_S)[0] or "nan") - began
            time.sleep(STEERING_S)
            counter = subprocess.Popen(FLANGE_COUNTER, env=env, stdout=subprocess.PIPE, text=True)
            shares = cpu_shares(process.pid, slices)
            flange_rate = float(counter.communicate(timeout=END_S)[0] or "nan")
            process.wait(END_S)
        except subprocess.TimeoutExpired as error:
            raise BenchError(f"The demo did not end: {last_line(log)}") from error
        finally:
            end_demo(process)
        if process.returncode != 0:
            raise BenchError(f"The demo found a fault: {last_line(log)}")
        return DemoRun(json.loads(report.read_text()), home_s, ready_s, shares, flange_rate)


HOME_WATCH = (
    sys.executable,
    "-c",
    """if True:
    import os, rospy, time
    from kuka_control.loop.transitions import Mode, State
    from rig_msgs.msg import KukaStatus

    def take(status):
        if status.reason == State.IDENTIFYING.text or status.mode in (Mode.HOME, Mode.PICK_UP, Mode.SERVO):
            print(time.monotonic(), flush=True)
            os._exit(0)

    rospy.init_node("bench_home", anonymous=True)
    rospy.Subscriber("kuka/status", KukaStatus, take, tcp_nodelay=True)
    rospy.spin()
    """,
)
FLANGE_COUNTER = (
    sys.executable,
    "-c",
    """if True:
    import rospy, time
    from tf2_msgs.msg import TFMessage
    from common.frames import FLANGE_MEASURED
    stamps = []
    rospy.init_node("bench_flange", anonymous=True)
    rospy.Subscriber("/tf", TFMessage, lambda m: stamps.extend(
        t.header.stamp.to_sec() for t in m.transforms if t.child_frame_id == FLANGE_MEASURED), tcp_nodelay=True)
    time.sleep(3.0)
    print((len(stamps) - 1) / (stamps[-1] - stamps[0]) if len(stamps) > 1 else "nan")
    """,
)


def cpu_shares(pid: int, slices: int) -> dict[str, np.ndarray]:
    """Returns for each program below a process, and itself, its share of one CPU in each slice of a second [%]."""
    shares: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(slices))
    before, began = cpu_times(pid), time.monotonic()
    for i in range(slices):
        time.sleep(SLICE_S)
        now, ended = cpu_times(pid), time.monotonic()
        for process, seconds in now.items():
            shares[process[1]][i] += 100.0 * (seconds - before.get(process, 0.0)) / (ended - began)
        before, began = now, ended
    return dict(shares)


def start_demo(arguments: Sequence[str], env: dict[str, str], output) -> subprocess.Popen:
    ports = (f"{name}:={port}" for name, port in ports_of_a_rig().items())
    command = (str(ROOT / "devel" / "lib" / "leap_rig" / "demo.py"), *arguments, *ports)
    return subprocess.Popen(command, env=env, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)


def wait_until_ready(process: subprocess.Popen, log: Path) -> None:
    deadline = time.monotonic() + READY_S
    while READY not in log.read_text(errors="replace"):
        if process.poll() is not None or time.monotonic() > deadline:
            raise BenchError(f"The arm of the demo did not come home: {last_line(log)}")
        time.sleep(0.1)


def end_demo(process: subprocess.Popen) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(15.0)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else "it said nothing"


def cpu_times(root: int) -> dict[tuple[int, str], float]:
    """Returns for a process and all below it, by id and name, the CPU time that it used so far [s]."""
    return {(pid, _name(words)): used for pid, (words, used) in processes_below(root).items()}


def processes_below(root: int) -> dict[int, tuple[list[str], float]]:
    """Returns for a process and all below it, by id, the words of its command line and the CPU time so far [s]."""
    found = {}
    with contextlib.suppress(psutil.NoSuchProcess):
        first = psutil.Process(root)
        for process in (first, *first.children(recursive=True)):
            with contextlib.suppress(psutil.Error):  # it has just ended
                used = process.cpu_times()
                found[process.pid] = process.cmdline(), used.user + used.system
    return found


def _name(words: list[str]) -> str:
    """Returns the program of a command line: the script where Python runs one."""
    names = [Path(word).name for word in words if word and not word.startswith("-")]
    if len(names) > 1 and names[0].startswith("python"):
        return names[1]
    return names[0] if names else "unknown"

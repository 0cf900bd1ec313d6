"""The toolbox client against the simulated controller, a process of its own: servo goals, paced and without pause."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np

from bench.measure import SRC, BenchError, Row, number, row
from bench.plain_client import PlainClient
from common.poses import translation
from kst import Feedback, KstClient, KstTiming

PROGRAM = SRC / "modules" / "rig_simulation" / "scripts" / "sunrise_controller.py"
READY = re.compile(r"listening on 127\.0\.0\.1:(\d+)")
TOOL = translation(0.0, 0.0, 0.106)
PERIOD_S = 1.0 / 250.0
SWING_RAD = 0.03
CALLS = {"servo": Feedback.DONE, "servo_joints": Feedback.JOINTS, "servo_unacknowledged": Feedback.NOTHING}
"""Feedback of a call, by the name of its row."""


def rows(quick: bool) -> list[Row]:
    """Returns round trip, jitter of the period and highest rate of each kind of servo goal."""
    paced, fast = (50, 50) if quick else (5000, 5000)
    table = []
    with simulated_controller() as port:
        timing = KstTiming(servo_reply=10.0, reply=10.0)
        with KstClient.connect("127.0.0.1", port, TOOL, timeout=10.0, timing=timing) as client:
            client.start_joint_servo()
            for name, feedback in CALLS.items():
                table += _call_rows(client, name, feedback, paced, fast)
        table += _peer_rows(port, fast)
    return table


@contextlib.contextmanager
def simulated_controller() -> Iterator[int]:
    """Runs a simulated controller on a free port; yields the port.

    Raises:
        BenchError: it did not start.
    """
    command = (sys.executable, str(PROGRAM), "--port", "0", "--control-port", "0")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    process = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        ready = READY.search(process.stdout.readline())
        if not ready:
            raise BenchError(f"The simulated controller did not start; try {PROGRAM.name} by hand.")
        yield int(ready[1])
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def _call_rows(client: KstClient, name: str, feedback: Feedback, paced: int, fast: int) -> list[Row]:
    def call(q: np.ndarray) -> None:
        client.servo(q, feedback)

    starts, ends = _paced(call, paced)
    late = np.abs(np.diff(starts) - PERIOD_S)
    way = "call (written, no answer)" if feedback is Feedback.NOTHING else "round trip"
    table = [
        row(f"kst {name}: {way}", 1e3 * (ends - starts), "ms", "goals at 250 Hz to the simulated controller, loopback"),
        row(f"kst {name}: jitter of the period", 1e3 * late, "ms", "how far a period was from 4 ms; time.sleep"),
    ]
    begin = time.perf_counter()
    for _ in range(fast - 1):
        call(_goal())
    client.servo(_goal())  # answered after all before it were read
    rate = fast / (time.perf_counter() - begin)
    return [
        *table,
        number(f"kst {name}: highest rate", rate, "1/s", f"{fast} goals without pause; the simulation is a part of it"),
    ]


def _peer_rows(port: int, fast: int) -> list[Row]:
    """Returns the highest rates of a plain client that checks nothing."""
    table: list[Row] = []
    deadline = time.monotonic() + 10.0
    while True:  # the simulated server takes a moment to start again
        try:
            with PlainClient.connected(port) as client:
                for name, word in (("servo", "jp"), ("servo_joints", "jpJP")):
                    begin = time.perf_counter()
                    for _ in range(fast):
                        client.goal(word, _goal().tolist())
                    rate = fast / (time.perf_counter() - begin)
                    table.append(number(f"plain client {name}: highest rate", rate, "1/s", "text, split, float"))
            return table
        except OSError as error:
            if time.monotonic() > deadline:
                raise BenchError(f"The simulated controller serves no second client: {error}.") from error
            time.sleep(0.1)


def _paced(call: Callable[[np.ndarray], object], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns when each call began and ended [s]."""
    starts, ends = np.empty(count), np.empty(count)
    due = time.perf_counter()
    for i in range(count):
        due = max(due + PERIOD_S, time.perf_counter())
        time.sleep(max(due - time.perf_counter(), 0.0))
        starts[i] = time.perf_counter()
        call(_goal())
        ends[i] = time.perf_counter()
    return starts, ends


def _goal() -> np.ndarray:
    """Returns a goal of a slow swing of all joints about zero, where the simulated arm stands at first."""
    return np.full(7, SWING_RAD * np.sin(np.pi * time.perf_counter()))

"""The toolbox client against the simulated controller, a process of its own: servo goals, paced and without pause.
Called as a program, `python -m bench.bench_client LINK COUNT` measures one of BAD_LINKS, in a network of its own."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np

from bench.measure import ROOT, SRC, BenchError, Goal, Row, number, row
from campaign.network.link import Link
from campaign.network.wire import Wire, in_own_network
from common.poses import translation
from kst import Feedback, KstClient, KstTiming, NoServer

PROGRAM = SRC / "modules" / "rig_simulation" / "scripts" / "sunrise_controller.py"
READY = re.compile(r"listening on [\d.]+:(\d+)")
TOOL = translation(0.0, 0.0, 0.106)
PERIOD_S = 1.0 / 250.0
SWING_RAD = 0.03
CALLS = {"servo": Feedback.DONE, "servo_joints": Feedback.JOINTS, "servo, unanswered": Feedback.NOTHING}
"""Feedback of a call, by the name of its row."""
PATIENT = KstTiming(servo_reply=10.0, reply=10.0)
BATCH = 16  # answers are read after so many streamed goals
PACED_HZ = 240.0
BAD_LINKS = {"1 % loss": Link(loss=0.01), "20 +- 10 ms each way": Link(delay=0.02, jitter=0.01)}


def rows(quick: bool) -> list[Row]:
    """Returns round trip and highest rate of each kind of servo goal, and the pace of goals on bad links."""
    paced, fast = (50, 50) if quick else (5000, 5000)
    table = []
    with simulated_controller() as port, _in_servo(port) as client:
        for name, feedback in CALLS.items():
            table += _call_rows(client, name, feedback, paced, fast)
        for word, feedback in (("jp", Feedback.DONE), ("jpJP", Feedback.JOINTS)):
            table.append(_streamed_row(client, word, feedback, fast))
    return [*table, *(_bad_link_row(name, 50 if quick else 2500) for name in BAD_LINKS)]


@contextlib.contextmanager
def simulated_controller(host: str = "127.0.0.1") -> Iterator[int]:
    """Runs a simulated controller on a free port of a loopback address; yields the port. Raises BenchError: it did not
    start."""
    command = (sys.executable, str(PROGRAM), "--host", host, "--port", "0", "--control-port", "0")
    process = subprocess.Popen(
        command, env=_environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
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


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def _call_rows(client: KstClient, name: str, feedback: Feedback, paced: int, fast: int) -> list[Row]:
    def call(q: np.ndarray) -> None:
        client.servo(q, feedback)

    starts, ends = _paced(call, paced)
    way = "call" if feedback is Feedback.NOTHING else "round trip"
    table = [
        row(f"kst {name}: {way}", 1e3 * (ends - starts), "ms", "goals at 250 Hz to the simulated controller, loopback"),
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


@contextlib.contextmanager
def _in_servo(port: int, timing: KstTiming = PATIENT, host: str = "127.0.0.1") -> Iterator[KstClient]:
    """Connects in servo mode; the simulated server takes a moment to start again after the client before."""
    deadline = time.monotonic() + 10.0
    while True:
        try:
            client = KstClient.connect(host, port, TOOL, timeout=10.0, timing=timing)
            break
        except NoServer as error:
            if time.monotonic() > deadline:
                raise BenchError(f"The simulated controller serves no second client: {error}.") from error
            time.sleep(0.1)
    with client:
        client.start_joint_servo()
        yield client


def _streamed_row(client: KstClient, word: str, feedback: Feedback, fast: int) -> Row:
    answered = 0
    begin = time.perf_counter()
    for i in range(fast):
        client.stream(_goal(), feedback)
        if i % BATCH == 0:
            answered += len(client.answers())
    answered += len(client.answers(10.0))
    rate = answered / (time.perf_counter() - begin)
    return number(f"kst {word} streamed: highest rate", rate, "1/s", f"{answered} answers to {fast} goals")


def _bad_link_row(name: str, count: int) -> Row:
    command = in_own_network([sys.executable, "-m", "bench.bench_client", name, str(count)])
    done = subprocess.run(command, cwd=ROOT, env=_environment(), capture_output=True, text=True)
    what, unit, goal = f"kst goals, {name}", "1/s", Goal(PACED_HZ, at_least=True)
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        return Row(what, None, None, unit, f"not measured: {said[-1]}", goal)
    rate, missed = json.loads(done.stdout)
    return number(what, rate, unit, f"{count} goals due at 250 Hz, {missed} answers missed", goal)


def _measure_bad_link(name: str, count: int) -> None:
    with Wire("arm") as wire, simulated_controller(wire.near) as port:
        wire.set(BAD_LINKS[name])
        with _in_servo(port, KstTiming(), wire.far) as client:
            print(json.dumps([_rate(client, count), client.counts.missed]))


def _rate(client: KstClient, count: int) -> float:
    """Returns how many goals a second leave of those that are due at 250 Hz; none does while an answer is missing."""
    due = begin = time.perf_counter()
    sent = 0
    for _ in range(count):
        due = max(due + PERIOD_S, time.perf_counter())
        time.sleep(max(due - time.perf_counter(), 0.0))
        if client.silence(0.02) == 0.0:
            client.stream(_goal())
            sent += 1
        client.answers()
    return sent / (time.perf_counter() - begin)


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


if __name__ == "__main__":
    _measure_bad_link(sys.argv[1], int(sys.argv[2]))

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

from bench import bad_link as bad_link_module
from bench.measure import SRC, BenchError, Goal, Peer, Row, number, row
from bench.plain_client import PlainClient
from common.poses import translation
from kst import Feedback, KstClient, KstTiming, NoServer

PROGRAM = SRC / "modules" / "rig_simulation" / "scripts" / "sunrise_controller.py"
READY = re.compile(r"listening on 127\.0\.0\.1:(\d+)")
TOOL = translation(0.0, 0.0, 0.106)
PERIOD_S = 1.0 / 250.0
SWING_RAD = 0.03
CALLS = {"servo": Feedback.DONE, "servo_joints": Feedback.JOINTS, "servo, unanswered": Feedback.NOTHING}
"""Feedback of a call, by the name of its row."""
PATIENT = KstTiming(servo_reply=10.0, reply=10.0)
BATCH = 16  # answers are read after so many streamed goals
PACED_HZ = 240.0
BAD_LINKS = {"1 % loss": (0.0, 0.0, 0.01), "20 +- 10 ms each way": (0.02, 0.01, 0.0)}
"""Delay [s], jitter [s] and loss in each direction."""


def rows(quick: bool) -> list[Row]:
    """Returns round trip, jitter and highest rate of each kind of servo goal, and the pace of goals on bad links."""
    paced, fast = (50, 50) if quick else (5000, 5000)
    table = []
    with simulated_controller() as port:
        peers = _peers(port, fast)
        with _in_servo(port) as client:
            for name, feedback in CALLS.items():
                table += _call_rows(client, name, feedback, paced, fast)
            for word, (feedback, peer) in peers.items():
                table.append(_streamed_row(client, word, feedback, peer, fast))
        for name, link in BAD_LINKS.items():
            with bad_link(port, *link) as proxy, _in_servo(proxy, KstTiming()) as client:
                table.append(_paced_stream_row(client, name, 50 if quick else 2500))
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
    way = "call" if feedback is Feedback.NOTHING else "round trip"
    table = [
        row(f"kst {name}: {way}", 1e3 * (ends - starts), "ms", "goals at 250 Hz to the simulated controller, loopback"),
        row(f"kst {name}: jitter", 1e3 * late, "ms", "how far a period was from 4 ms; time.sleep"),
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


def _peers(port: int, fast: int) -> dict[str, tuple[Feedback, Peer]]:
    """Returns the highest rates of a plain client that checks nothing, by the word of its goals."""
    found = {}
    with PlainClient.connected(port) as client:
        for word, feedback in (("jp", Feedback.DONE), ("jpJP", Feedback.JOINTS)):
            begin = time.perf_counter()
            for _ in range(fast):
                client.goal(word, _goal().tolist())
            found[word] = feedback, Peer("plain loop", fast / (time.perf_counter() - begin))
    return found


@contextlib.contextmanager
def _in_servo(port: int, timing: KstTiming = PATIENT) -> Iterator[KstClient]:
    """Connects in servo mode; the simulated server takes a moment to start again after the client before."""
    deadline = time.monotonic() + 10.0
    while True:
        try:
            client = KstClient.connect("127.0.0.1", port, TOOL, timeout=10.0, timing=timing)
            break
        except NoServer as error:
            if time.monotonic() > deadline:
                raise BenchError(f"The simulated controller serves no second client: {error}.") from error
            time.sleep(0.1)
    with client:
        client.start_joint_servo()
        yield client


@contextlib.contextmanager
def bad_link(port: int, delay: float, jitter: float, loss: float) -> Iterator[int]:
    """Runs a proxy to the port in a process of its own; yields its port. Times in seconds."""
    command = (sys.executable, str(bad_link_module.__file__), *map(str, (port, delay, jitter, loss)))
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield int(process.stdout.readline())
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def _streamed_row(client: KstClient, word: str, feedback: Feedback, peer: Peer, fast: int) -> Row:
    """Returns the highest rate of streamed goals, each answer of which is checked."""
    answered = 0
    begin = time.perf_counter()
    for i in range(fast):
        client.stream(_goal(), feedback)
        if i % BATCH == 0:
            answered += len(client.answers())
    answered += len(client.answers(10.0))
    rate = answered / (time.perf_counter() - begin)
    return number(f"kst {word} streamed: highest rate", rate, "1/s", f"{answered} answers to {fast} goals", peer=peer)


def _paced_stream_row(client: KstClient, link: str, count: int) -> Row:
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
    rate = sent / (time.perf_counter() - begin)
    how = f"{count} goals due at 250 Hz, {client.counts.missed} answers missed"
    return number(f"kst goals, {link}", rate, "1/s", how, Goal(PACED_HZ, at_least=True))


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
